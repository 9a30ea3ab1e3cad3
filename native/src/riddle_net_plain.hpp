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

inline std::int16_t settled(std::int32_t sum, const Layer& layer) {
  return static_cast<std::int16_t>(std::clamp(sum >> layer.shift, layer.low, layer.high));
}

// Weights of block after block, for the inputs from `in` on, an even number.
inline const std::int16_t* weights_at(const Layer& layer, std::size_t block, std::size_t in) {
  return layer.weights.data() + in / 2 * layer.pair_step + block * layer.block_step;
}

inline void layer_plainly(const Layer& layer, const std::int16_t* in, std::int16_t* out) {
  for (std::size_t block = 0; block < layer.blocks(); ++block) {
    std::array<std::int32_t, kBlock> sums;
    std::copy_n(layer.bias.data() + block * kBlock, kBlock, sums.begin());
    for (std::size_t i = 0; i < layer.in; i += 2) {
      const std::int16_t* const w = weights_at(layer, block, i);
      for (std::size_t o = 0; o < kBlock; ++o) sums[o] += w[2 * o] * in[i] + w[2 * o + 1] * in[i + 1];
    }
    for (std::size_t o = 0; o < kBlock; ++o) out[block * kBlock + o] = settled(sums[o], layer);
  }
}

}  // namespace lidarcodec::net_forms
