// A layer of a network in plain C++, which defines the results, and what the other forms share with it.
#pragma once
#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>

#include "network/net.hpp"

namespace lidarcodec::net_forms {

using Layer = RiddleNet::Layer;
// Inputs or hidden values of one return, between two layers.
struct alignas(64) Words {
  std::array<std::int16_t, kMaxHidden> of;
};

// The initial values of a return's sums are the sum of these two.
struct InitialSums {
  const std::int32_t *row, *scale;
};

// Those of the first layer depend on the inputs that name row and scale; those of others are the same for all returns.
inline InitialSums initial_of_return(const Layer& layer, const NetValues& values) {
  if (!layer.has_conditional_biases) return {layer.rows.data(), layer.scales.data()};
  const std::size_t width = layer.blocks() * kTileOutputs;
  return {layer.rows.data() + row_bias_of(values.in[kRowInput]) * width,
          layer.scales.data() + scale_bias_of(values.in[kScaleInput]) * width};
}

template <std::size_t N>
std::array<InitialSums, N> initial_of(const Layer& layer, const std::array<NetValues*, N>& values) {
  std::array<InitialSums, N> initial;
  for (std::size_t r = 0; r < N; ++r) initial[r] = initial_of_return(layer, *values[r]);
  return initial;
}

// A sum, shifted to the units of what comes out and clipped.
inline std::int16_t clipped(std::int32_t sum, const Layer& layer) {
  return static_cast<std::int16_t>(std::clamp(sum >> layer.shift, layer.low, layer.high));
}

inline constexpr std::size_t kTileWeights = kTileInputs * kTileOutputs;

inline void layer_plainly(const Layer& layer, const InitialSums& begin, const std::int16_t* in, std::int16_t* out) {
  for (std::size_t block = 0; block < layer.blocks(); ++block) {
    std::array<std::int32_t, kTileOutputs> sums;
    for (std::size_t o = 0; o < kTileOutputs; ++o)
      sums[o] = begin.row[block * kTileOutputs + o] + begin.scale[block * kTileOutputs + o];
    for (std::size_t tile = layer.tiles_of[block]; tile < layer.tiles_of[block + 1]; ++tile) {
      const std::int16_t *const w = layer.weights.data() + tile * kTileWeights, *const x = in + layer.inputs_of[tile];
      for (std::size_t o = 0; o < kTileOutputs; ++o)
        sums[o] += w[2 * o] * x[0] + w[2 * o + 1] * x[1] + w[2 * (kTileOutputs + o)] * x[2] +
                   w[2 * (kTileOutputs + o) + 1] * x[3];
    }
    for (std::size_t o = 0; o < kTileOutputs; ++o) out[block * kTileOutputs + o] = clipped(sums[o], layer);
  }
}

}  // namespace lidarcodec::net_forms
