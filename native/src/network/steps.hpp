// Optimiser steps: Adam (Kingma and Ba 2015, arXiv:1412.6980) on single parameters, and Adam on weights in a rotated
// basis.
//
// The inputs of a network are correlated, so the gradients of its weights are, too, and Adam on single weights has to
// take short steps. SOAP (Vyas et al. 2024, arXiv:2409.11321) rotates weights into the eigenbasis of their gradients'
// second moments and runs Adam there; ours does so on the side of the inputs, for blocks of sixteen outputs. Sums have
// a fixed order, as in network/products.hpp.
#pragma once
#include <cstddef>
#include <vector>

#include "network/products.hpp"

namespace lidarcodec {

// rate: learning rate; first, second: Adam's bias corrections, 1 / (1 - beta^t); stays: decay of the running mean.
struct AdamStep {
  float rate, first, second, stays;
};

inline constexpr float kBeta1 = 0.9f, kBeta2 = 0.99f;  // decays of Adam's first and second moments

struct Moments {
  std::vector<float> first, second;
};

// A step of parameters and of their running mean.
void take_step(const AdamStep& step, const std::vector<float>& gradients, Moments& moments, std::vector<float>& values,
               std::vector<float>& mean);

// The weights of some inputs for `width` outputs from `column` on, part of a matrix (inputs, outputs).
class RotatedWeights {
 public:
  RotatedWeights(std::size_t column, std::size_t width, std::vector<std::size_t> inputs);

  // number: of the step, from 0 on; outputs: columns of the matrix.
  void take_step(const AdamStep& step, std::size_t number, std::size_t outputs, const std::vector<float>& gradients,
                 std::vector<float>& values, std::vector<float>& mean);

 private:
  void gather(std::size_t outputs, const std::vector<float>& gradients);
  void update_basis();

  std::size_t column_, width_;
  std::vector<std::size_t> inputs_;
  std::size_t size_;                     // of the basis: inputs, rounded up to a multiple of eight
  std::vector<float> second_moments_;    // (size, size): running mean of G G^T, G the gradient (size, width)
  std::vector<float> basis_;             // (size, size): an eigenvector in each row
  Moments moments_;                      // (size, width), in the rotated basis
  std::vector<float> gradient_, steps_;  // (size, width)
};

// The weights of a layer that are within `runs`, in groups of a few inputs.
std::vector<RotatedWeights> rotated_weights(const Runs& runs, std::size_t outputs);

}  // namespace lidarcodec
