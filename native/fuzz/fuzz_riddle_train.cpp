// Any bytes as samples that a network is trained on: whatever they say, its weights stay numbers. The input's first
// bytes say with what settings.
#include <cmath>
#include <cstdlib>
#include <vector>

#include "base/error.hpp"
#include "network/train.hpp"
#include "parts/fuzz_input.hpp"

using namespace lidarcodec;

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  FuzzInput input(data, size);
  const std::uint8_t kind = input.byte();
  TrainSettings settings;
  settings.rate = static_cast<float>(input.byte()) / 64.0f;
  settings.mean = static_cast<float>(input.byte()) / 128.0f;
  settings.beside = static_cast<float>(input.byte()) / 255.0f;
  settings.batch = 8 + input.byte() % 32u;
  settings.room = 1 + input.byte();
  settings.turns = 1 + input.byte();
  settings.held_room = 1 + input.byte();
  const std::size_t inputs = kind & 1u ? kInputsAlone : kInputsExpecting;
  const std::array<std::size_t, 4> dims = {inputs, 8u + 8u * (kind >> 1 & 3u), 8u + 8u * (kind >> 3 & 3u), kNetOutputs};
  std::array<std::vector<std::int16_t>, 3> weights;
  std::array<std::vector<std::int32_t>, 3> biases;
  std::array<GivenLayer, 3> layers;
  for (std::size_t l = 0; l < 3; ++l) {
    for (std::size_t i = 0; i < dims[l] * dims[l + 1]; ++i)
      weights[l].push_back(static_cast<std::int16_t>((i * 40503u >> 3) % 4001u) - 2000);
    biases[l].assign(dims[l + 1], 1000);
    layers[l] = {dims[l], dims[l + 1], weights[l].data(), biases[l].data(), 12};
  }
  std::vector<std::int8_t> cases;
  for (std::size_t i = 0; i < kConditionalBiases * dims[1]; ++i)
    cases.push_back(static_cast<std::int8_t>(i * 89u % 255u - 127u));
  if ((kind & 64u) != 0) layers[0].conditional_bias = cases.data();
  const std::vector<std::uint8_t> rest = input.rest();
  RiddleSamples samples;
  samples.inputs = kind & 32u ? kInputsAlone : inputs;
  NetValues values;
  std::array<std::int16_t, 16> chances{};
  for (std::size_t at = 0; at + 8 <= rest.size(); at += 8) {
    for (std::size_t i = 0; i < samples.inputs; ++i)
      values.in[i] = static_cast<std::int8_t>(rest[(at + i) % rest.size()]);
    for (std::size_t i = 0; i < 16; ++i) {
      chances[i] = static_cast<std::int16_t>(10 + (rest[at + i % 8] * 257u + i) % 32748u);
      values.out[i] = static_cast<std::int16_t>(rest[at + (i + 3) % 8] << 8);
    }
    const auto bit = [&](std::size_t i) {
      const std::uint8_t given = rest[at + i] >> 6;
      return given > 1 ? RiddleSamples::kNone : given;
    };
    if (samples.next_is_taken())
      samples.take(values, rest[at] % 16u, {bit(1), bit(2), bit(3)}, chances.data(),
                   {rest[at + 4] * 300 - 38000, rest[at + 5] - 128, 0});
  }
  try {
    RiddleTrainer trainer(layers, settings, kind);
    trainer.add(samples, false);
    trainer.add(samples, true);
    trainer.train(6, [] { return true; });
    const double cost = trainer.cost(RiddleNet(layers), 0.5f);
    if (!std::isfinite(cost) || cost < 0) std::abort();
    for (const RiddleTrainer::Layer& layer : trainer.layers())
      for (const auto* numbers : {&layer.weights, &layer.bias, &layer.conditional_bias})
        for (const float number : *numbers)
          if (!std::isfinite(number)) std::abort();
  } catch (const Error&) {
  }
  return 0;
}
