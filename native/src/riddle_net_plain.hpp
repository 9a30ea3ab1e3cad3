// A layer of a network in C++ alone, which says what is computed, and what other forms share with it.
#pragma once
#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>

#include "riddle_net.hpp"

namespace lidarcodec::net_forms {

using Layer = RiddleNet::Layer;
inline constexpr std::size_t kBlock = 16;

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

// Weights of block after block, for the inputs from `in` on, an even number.
inline const std::int16_t* weights_at(const Layer& layer, std::size_t block, std::size_t in) {
  return layer.weights.data() + in / 2 * layer.pair_step + block * layer.block_step;
}

inline void layer_plainly(const Layer& layer, const Begin& begin, const std::int16_t* in, std::int16_t* out) {
  for (std::size_t block = 0; block < layer.blocks(); ++block) {
    std::array<std::int32_t, kBlock> sums;
    for (std::size_t o = 0; o < kBlock; ++o) sums[o] = begin.row[block * kBlock + o] + begin.scale[block * kBlock + o];
    for (std::size_t i = 0; i < layer.in; i += 2) {
      const std::int16_t* const w = weights_at(layer, block, i);
      for (std::size_t o = 0; o < kBlock; ++o) sums[o] += w[2 * o] * in[i] + w[2 * o + 1] * in[i + 1];
    }
    for (std::size_t o = 0; o < kBlock; ++o) out[block * kBlock + o] = settled(sums[o], layer);
  }
}

}  // namespace lidarcodec::net_forms
