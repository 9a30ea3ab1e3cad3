// Training of a network of codec riddle while it is in use, on returns that were just coded.
//
// A copy of the network in single precision is trained by Adam in mini-batches; its weights take their steps in a
// rotated basis (network/steps.hpp). The loss is what the coder would spend on a return, in natural units: the log odds
// of the network and those of the contexts are added, as the coder does. Training is aware of quantisation: hidden
// values are rounded as they will be, and so are the weights of a first layer that fits bytes; gradients pass through
// the rounding (the straight-through estimator, Bengio et al. 2013, arXiv:1308.3432). Biases of rows and scales begin
// with 0 if the network has none. Pruned tiles stay pruned.
//
// The result is a running mean of about the last eighth of all steps (polynomial-decay averaging, Shamir and Zhang
// 2013, arXiv:1212.1824). Arithmetic uses no fused operations and a fixed order of sums, so the same samples, seed and
// number of steps give the same network on every machine.
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
  float rate = 1e-3f;        // of Adam
  float mean = 0.99f;        // largest decay of the running mean in a step
  float beside = 1.0f;       // weight of the contexts' log odds
  std::size_t batch = 256;   // samples in a step
  std::size_t room = 65536;  // most samples to train on; new ones replace old ones at random
  std::size_t turns =
      1024;  // limits the samples to so many times the last addition: old ones do not outnumber new ones
  std::size_t held_room = 16384;  // newest held-out samples, for validation
};

// A buffer of samples.
class SampleBuffer {
 public:
  SampleBuffer(std::size_t inputs, std::size_t capacity) : inputs_(inputs), capacity_(capacity) {}

  std::size_t size() const { return leaf_.size(); }
  void put(const RiddleSamples& from, std::size_t i, std::size_t at);  // at: at most size()

  const std::int8_t* in(std::size_t i) const { return in_.data() + i * inputs_; }
  const std::int16_t* context_odds(std::size_t i) const { return context_odds_.data() + i * RiddleSamples::kDecisions; }
  std::uint32_t leaf(std::size_t i) const { return leaf_[i]; }
  const std::uint8_t* offsets(std::size_t i) const { return offsets_.data() + i * RiddleSamples::kOffsets; }
  std::size_t capacity() const { return capacity_; }

 private:
  std::size_t inputs_, capacity_;
  std::vector<std::int8_t> in_;
  std::vector<std::int16_t> context_odds_;
  std::vector<std::uint8_t> leaf_, offsets_;
};

class RiddleTrainer {
 public:
  // Weights (in, out), biases (out,) and, of the first layer, biases of rows and scales (96, out), in natural units.
  struct Layer {
    std::size_t in = 0, out = 0;
    std::vector<float> weights, bias, conditional_bias;
  };

  // given: layers that RiddleNet accepts. Raises Settings for settings out of range.
  RiddleTrainer(const std::array<GivenLayer, kNetLayers>& given, const TrainSettings& settings, std::uint32_t seed);

  // Adds samples; held: for validation. Raises Section for samples with another number of inputs.
  void add(const RiddleSamples& samples, bool held);

  // Takes at most `steps` steps, and stops when `go_on` is false; gives their number. 0 with fewer samples than a
  // batch.
  std::size_t train(std::size_t steps, const std::function<bool()>& go_on);

  // The running mean of the last steps.
  const std::array<Layer, kNetLayers>& layers() const { return mean_; }

  // Mean bits of a held-out sample with a network, and the contexts weighted by `beside`; 0 without samples.
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
  float beta1_power_ = 1.0f, beta2_power_ = 1.0f;  // beta^steps, of Adam's bias correction
  std::array<Layer, kNetLayers> layers_, mean_, gradient_;
  std::array<std::array<Moments, 2>, kNetLayers> moments_;  // of biases, and of biases of rows and scales
  std::array<std::vector<RotatedWeights>, kNetLayers> rotated_weights_;
  std::array<Runs, kNetLayers> runs_;  // the inputs whose tiles are not pruned
  SampleBuffer learned_, held_;
  // Of a batch: inputs and outputs of each layer (batch, out), and the gradients of the loss by them.
  std::array<std::vector<float>, kNetLayers + 1> values_, gradients_;
  std::array<std::vector<std::uint8_t>, kNetLayers - 1> unclipped_;  // whether a hidden value is within its limits
  std::vector<float> transposed_;                                    // weights (out, in)
  std::vector<float> rounded_;                                       // the first layer's weights (in, out), quantised
  float byte_unit_ = 0.0f;                                           // their step; 0: they are not quantised
  std::vector<std::size_t> drawn_;                                   // the samples of the batch
};

}  // namespace lidarcodec
