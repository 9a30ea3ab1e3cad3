// Training of a network of codec riddle while it is in use, on returns that were just coded.
//
// A copy of the network in single precision takes steps by Adam, a few hundred samples each; weights do along the directions
// that network/steps.hpp finds. The loss is what the coder would pay: the network's log odds and those that the contexts said
// of the same return, added up. Hidden values are rounded as they will be, and so are the weights of a first layer that began
// in bytes; slopes go through as if they were not.
// Biases of rows and scales, where the network has none yet, begin with 0. Tiles of weights that are empty stay so.
// (Rounded only when it was handed out, a network lost more than it had learned.) What is handed out is a running mean of
// about the last eighth of all steps (polynomial-decay averaging, Shamir and Zhang 2013, arXiv:1212.1824), so that many
// steps a frame are averaged over as much of the stream as few. Arithmetic is without fused operations and adds up in one
// order, so the same samples, seed and number of steps give the same network on every machine.
#pragma once
#include <array>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <vector>

#include "network/net.hpp"
#include "network/products.hpp"
#include "network/samples.hpp"
#include "network/steps.hpp"

namespace lidarcodec {

struct TrainSettings {
  float rate = 1e-3f;         // of Adam
  float mean = 0.99f;         // of the running mean: how much of it stays at each step, at most
  float beside = 1.0f;        // how much of what contexts said counts
  std::size_t batch = 256;    // samples in a step
  std::size_t room = 65536;   // samples to learn from, at most; newer ones take the places of any
  std::size_t turns = 1024;   // how many additions as large as the last one they are, at most
  std::size_t held_room = 16384;  // newest samples that are measured on and never learned from
};

// Samples of one kind, as many as there is room for.
class SampleRoom {
 public:
  SampleRoom(std::size_t inputs, std::size_t room) : inputs_(inputs), room_(room) {}

  std::size_t size() const { return leaf_.size(); }
  void put(const RiddleSamples& from, std::size_t i, std::size_t at);  // at: size() or less

  const std::int8_t* in(std::size_t i) const { return in_.data() + i * inputs_; }
  const std::int16_t* said(std::size_t i) const { return said_.data() + i * RiddleSamples::kDecisions; }
  std::uint32_t leaf(std::size_t i) const { return leaf_[i]; }
  const std::uint8_t* offsets(std::size_t i) const { return offsets_.data() + i * RiddleSamples::kOffsets; }
  std::size_t room() const { return room_; }

 private:
  std::size_t inputs_, room_;
  std::vector<std::int8_t> in_;
  std::vector<std::int16_t> said_;
  std::vector<std::uint8_t> leaf_, offsets_;
};

class RiddleTrainer {
 public:
  // Weights (in, out), biases and, of the first layer, those of cases (96, out) in natural units.
  struct Layer {
    std::size_t in = 0, out = 0;
    std::vector<float> weights, bias, cases;
  };

  // given: as for RiddleNet, which has checked them. Raises Settings for settings out of range.
  RiddleTrainer(const std::array<GivenLayer, kNetLayers>& given, const TrainSettings& settings, std::uint32_t seed);

  // Takes samples; held: to measure on. Raises Section for samples of other inputs.
  void add(const RiddleSamples& samples, bool held);

  // Takes at most so many steps, and none when `go_on` says no; how many it took. None without samples for a step.
  std::size_t train(std::size_t steps, const std::function<bool()>& go_on);

  // The running mean of the last steps.
  const std::array<Layer, kNetLayers>& layers() const { return mean_; }

  // Bits of a held sample under a network and so much of what contexts said, mean; 0 without samples.
  double cost(const RiddleNet& net, float beside) const;

  std::size_t samples() const { return learned_.size(); }
  std::size_t held() const { return held_.size(); }
  std::size_t steps() const { return steps_; }
  std::size_t inputs() const { return layers_[0].in; }

 private:
  void step();
  void forward();
  void backward();
  void update();
  std::uint32_t random();

  TrainSettings settings_;
  std::uint64_t seed_;
  std::size_t steps_ = 0, next_held_ = 0;
  float left_first_ = 1.0f, left_second_ = 1.0f;  // of Adam's moments: how much of their beginning is left
  std::array<Layer, kNetLayers> layers_, mean_, gradient_;
  std::array<std::array<Moments, 2>, kNetLayers> moments_;  // of biases and of those of cases
  std::array<std::vector<TurnedWeights>, kNetLayers> turned_weights_;
  std::array<Runs, kNetLayers> runs_;  // which weights are not in empty tiles
  SampleRoom learned_, held_;
  // Of a batch: inputs and what comes out of each layer (batch, out), and the loss's slopes there; weights (out, in).
  std::array<std::vector<float>, kNetLayers + 1> values_, slopes_;
  std::array<std::vector<std::uint8_t>, kNetLayers - 1> moves_;  // whether a hidden value is within its limits
  std::vector<float> turned_;
  std::vector<float> rounded_;  // the first layer's weights (in, out), as they will be
  float byte_unit_ = 0.0f;      // what they are rounded to; 0: they are not
  std::vector<std::size_t> drawn_;
};

}  // namespace lidarcodec
