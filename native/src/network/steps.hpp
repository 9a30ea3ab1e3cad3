// Steps of training: Adam on numbers one by one, or on weights along directions in which their slopes go together.
//
// Inputs of a network are much alike, so slopes of its weights are: one by one, none can take a long step. Weights of sixteen
// sums (a block) are turned, as the eigenvectors of what their slopes were lie, and take their steps there (SOAP, Vyas et al.
// 2024, arXiv:2409.11321, on the side of the inputs). Sums are added up in one order, as in network/products.hpp.
#pragma once
#include <cstddef>
#include <vector>

#include "network/products.hpp"

namespace lidarcodec {

// rate: how long a step is; first, second: by how much Adam's moments are too small yet; stays: how much of a running mean
// stays.
struct AdamStep {
  float rate, first, second, stays;
};

inline constexpr float kFirstDecay = 0.9f, kSecondDecay = 0.99f;

struct Moments {
  std::vector<float> first, second;
};

// Numbers and their running mean.
void take_step(const AdamStep& step, const std::vector<float>& slopes, Moments& moments, std::vector<float>& values, std::vector<float>& mean);

// Weights of sums `column` and so on, `width` of them, and of some inputs, within weights (inputs, sums).
class TurnedWeights {
 public:
  TurnedWeights(std::size_t column, std::size_t width, std::vector<std::size_t> inputs);

  // number: of the step, from 0 on; sums: how many there are.
  void take_step(const AdamStep& step, std::size_t number, std::size_t sums, const std::vector<float>& slopes, std::vector<float>& values, std::vector<float>& mean);

 private:
  void gather(std::size_t sums, const std::vector<float>& slopes);
  void turn();

  std::size_t column_, width_;
  std::vector<std::size_t> inputs_;
  std::size_t size_;                   // of the basis: inputs, made up to a multiple of eight
  std::vector<float> together_;        // (size, size): slopes of two inputs multiplied, running mean
  std::vector<float> basis_;           // (size, size): a direction in each row
  Moments moments_;                    // (size, width), as they are turned
  std::vector<float> slopes_, moves_;  // (size, width)
};

// Those weights of a layer with so many sums that are within `runs`, in groups of a few inputs.
std::vector<TurnedWeights> turned_weights(const Runs& runs, std::size_t sums);

}  // namespace lidarcodec
