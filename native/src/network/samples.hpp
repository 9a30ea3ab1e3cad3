// Samples that train networks of codec riddle: the inputs of returns, their decisions, and the contexts' log odds.
#pragma once
#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "bits/cells.hpp"
#include "network/net.hpp"

namespace lidarcodec {

// The log odds of a probability: the inverse of `probabilities`, up to its rounding.
inline std::int32_t log_odds_of(std::int32_t p) {
  static const std::vector<std::uint16_t> roots = [] {
    std::vector<std::uint16_t> found(kOne / 2 + 1);
    for (std::uint32_t t = 0; t < 65535; ++t) {
      const std::uint32_t square = (t * t) >> 16, rare = (square * t) >> 18;
      if (rare < found.size()) found[rare] = static_cast<std::uint16_t>(t);
    }
    return found;
  }();
  const std::int32_t rare = std::min(p, kOne - p);
  const std::int32_t away = (65534 - roots[static_cast<std::size_t>(rare)]) / 2;
  return p < kOne - p ? -1 - away : away;
}

struct RiddleSamples {
  static constexpr std::uint8_t kNone = 255;
  static constexpr std::size_t kOffsets = 3;
  static constexpr std::size_t kDecisions = 4 + kOffsets;  // of the tree, then offset bits

  std::uint32_t share = 65536;  // of 65536 returns are taken, at random
  std::uint32_t seed = 1;
  std::size_t inputs = kInputsAlone;
  std::vector<std::int8_t> in;             // `inputs` numbers a sample
  std::vector<std::uint8_t> leaf;          // 0 to 15
  std::vector<std::uint8_t> offset;        // the first three offset bits, kNone where there are fewer
  std::vector<std::int16_t> context_odds;  // the contexts' log odds of each decision

  std::size_t size() const { return leaf.size(); }

  // Whether the next return is taken, by the linear congruential generator of Numerical Recipes.
  bool next_is_taken() {
    seed = seed * 1664525u + 1013904223u;
    return seed >> 16 < share;
  }

  // chances: probabilities of the nodes of the tree, with the network's part; of_cells: contexts' log odds of the
  // offset bits.
  [[gnu::noinline]] void take(const NetValues& values, std::uint32_t of_leaf,
                              const std::array<std::uint8_t, kOffsets>& of_offset, const std::int16_t* chances,
                              const std::array<std::int32_t, kOffsets>& of_cells) {
    const auto clamped = [](std::int32_t odds) { return static_cast<std::int16_t>(std::clamp(odds, -32768, 32767)); };
    in.insert(in.end(), values.in.begin(), values.in.begin() + static_cast<std::ptrdiff_t>(inputs));
    leaf.push_back(static_cast<std::uint8_t>(of_leaf));
    offset.insert(offset.end(), of_offset.begin(), of_offset.end());
    for (std::uint32_t level = 4; level >= 1; --level) {
      const std::uint32_t node = (16 + of_leaf) >> level;
      context_odds.push_back(clamped(log_odds_of(chances[node]) - values.out[node]));
    }
    for (const std::int32_t odds : of_cells) context_odds.push_back(clamped(odds));
  }
};

}  // namespace lidarcodec
