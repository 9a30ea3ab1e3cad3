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
  static constexpr std::size_t kOffsets = 3;

  std::uint32_t share = 65536;  // of 65536 returns; the others are left out at random
  std::uint32_t seed = 1;
  std::size_t inputs = kInputsAlone;
  std::vector<std::int8_t> in;        // `inputs` numbers a sample
  std::vector<std::uint8_t> leaf;     // 0 to 15
  std::vector<std::uint8_t> offset;   // the first three offset bits, kNone where there are fewer

  void take(const NetValues& values, std::uint32_t of_leaf, const std::array<std::uint8_t, kOffsets>& of_offset) {
    seed = seed * 1664525u + 1013904223u;
    if (seed >> 16 >= share) return;
    in.insert(in.end(), values.in.begin(), values.in.begin() + static_cast<std::ptrdiff_t>(inputs));
    leaf.push_back(static_cast<std::uint8_t>(of_leaf));
    offset.insert(offset.end(), of_offset.begin(), of_offset.end());
  }
};

}  // namespace lidarcodec
