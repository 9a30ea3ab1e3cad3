// What networks of codec riddle are trained with: inputs of returns, and what came.
#pragma once
#include <array>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "riddle_net.hpp"

namespace lidarcodec {

struct RiddleSamples {
  static constexpr std::uint8_t kNone = 255;

  std::uint32_t share = 65536;  // of 65536 returns; the others are left out at random
  std::uint32_t seed = 1;
  std::size_t inputs = kInputsAlone;
  std::vector<std::int8_t> in;        // `inputs` numbers a sample
  std::vector<std::uint8_t> leaf;     // 0 to 15
  std::vector<std::uint8_t> offset;   // first offset bit, or kNone

  void take(const NetValues& values, std::uint32_t of_leaf, std::uint8_t of_offset) {
    seed = seed * 1664525u + 1013904223u;
    if (seed >> 16 >= share) return;
    for (std::size_t i = 0; i < inputs; ++i) in.push_back(static_cast<std::int8_t>(values.in[i]));
    leaf.push_back(static_cast<std::uint8_t>(of_leaf));
    offset.push_back(of_offset);
  }
};

}  // namespace lidarcodec
