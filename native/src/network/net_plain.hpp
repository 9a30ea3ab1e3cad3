// A layer of a network in C++ alone, which says what is computed, and what other forms share with it.
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
  std::array<std::int16_t, kMostHidden> of;
};

// What the sums of a return begin with, both added up.
struct Begin {
  const std::int32_t *row, *scale;
};

// Of a first layer, by the inputs that tell row and scale; of others the same for all returns.
inline Begin begin_of(const Layer& layer, const NetValues& values) {
  if (!layer.has_cases) return {layer.rows.data(), layer.scales.data()};
  const std::size_t width = layer.blocks() * kBlock;
  return {layer.rows.data() + row_case(values.in[kRowInput]) * width, layer.scales.data() + scale_case(values.in[kScaleInput]) * width};
}

template <std::size_t N>
std::array<Begin, N> begins_of(const Layer& layer, const std::array<NetValues*, N>& values) {
  std::array<Begin, N> begins;
  for (std::size_t r = 0; r < N; ++r) begins[r] = begin_of(layer, *values[r]);
  return begins;
}

inline std::int16_t settled(std::int32_t sum, const Layer& layer) {
  return static_cast<std::int16_t>(std::clamp(sum >> layer.shift, layer.low, layer.high));
}

inline constexpr std::size_t kTileWeights = kTileInputs * kBlock;

inline void layer_plainly(const Layer& layer, const Begin& begin, const std::int16_t* in, std::int16_t* out) {
  for (std::size_t block = 0; block < layer.blocks(); ++block) {
    std::array<std::int32_t, kBlock> sums;
    for (std::size_t o = 0; o < kBlock; ++o) sums[o] = begin.row[block * kBlock + o] + begin.scale[block * kBlock + o];
    for (std::size_t tile = layer.tiles_of[block]; tile < layer.tiles_of[block + 1]; ++tile) {
      const std::int16_t *const w = layer.weights.data() + tile * kTileWeights, *const x = in + layer.inputs_of[tile];
      for (std::size_t o = 0; o < kBlock; ++o)
        sums[o] += w[2 * o] * x[0] + w[2 * o + 1] * x[1] + w[2 * (kBlock + o)] * x[2] + w[2 * (kBlock + o) + 1] * x[3];
    }
    for (std::size_t o = 0; o < kBlock; ++o) out[block * kBlock + o] = settled(sums[o], layer);
  }
}

}  // namespace lidarcodec::net_forms
