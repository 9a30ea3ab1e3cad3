// Returns that lie beyond the last leaf, as codec riddle has them: there, the last return says little, and they are counted
// from the likeliest of the other ranges around instead.
//
// Ranges around that lie beyond the last leaf on the same side are *anchors*, the likeliest first. A second tree of 16
// leaves lies around the first of them, in a scale of its own, and contexts are where the others lie as seen from it.
#pragma once
#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>

#include "bits/cells.hpp"
#include "predictive/positions.hpp"
#include "predictive/model.hpp"

namespace lidarcodec {

inline constexpr std::size_t kAnchors = 10;
inline constexpr std::array<std::int16_t, 4> kBeyondRates = {1440, 920, 640, 460};
// The tree of one return.
struct BeyondPlace {
  std::int32_t anchor;  // where its differences are counted from, away from the base
  std::uint32_t scale;
  std::array<std::uint32_t, kBeyondContexts> slots;

  // candidates: ranges around, sixteenths, the likeliest first; origin, down: where the cell begins that the return lies away from, and to which side;
  // begin: how far away at least; scale_here: scale class of the first tree.
  BeyondPlace(const std::array<std::int32_t, kAnchors>& candidates, std::int32_t origin, bool down, std::int32_t begin,
              std::uint32_t scale_here) {
    const std::int32_t turned = down ? -1 : 0;
    std::array<std::int32_t, kAnchors> at{};
    std::size_t n = 0;
    std::uint32_t who = 0;
    for (std::size_t i = 0; i < kAnchors; ++i) {
      const std::int32_t away = ((candidates[i] - origin) >> kDifferenceBits) ^ turned;
      if (away < begin) continue;
      if (n == 0) who = static_cast<std::uint32_t>(i) + 1;
      at[n++] = away;
    }
    if (n == 0) at[0] = begin + std::min(4 << kBeyondBits[scale_here], 4096);
    for (std::size_t i = std::max<std::size_t>(n, 1); i < 4; ++i) at[i] = at[i - 1];
    anchor = at[0];
    scale = n < 2 ? std::min(scale_here + 4, kScaleClasses - 1)
                  : scale_class((difference(16 * (at[1] - anchor)) + difference(16 * (at[2] - anchor))) / 4 + 8);
    scale = std::max(scale, scale_here > 2 ? scale_here - 2 : 0);
    const auto position = [&](std::int32_t other) {
      return static_cast<std::uint32_t>(PlainPositions::position_of(4 * (other - anchor), scale));
    };
    const std::uint32_t first = position(begin), second = position(at[1]), third = position(at[2]);
    const std::array<std::uint32_t, kBeyondContexts> of = {scale * 16 + who,
                                                           second * 16 + third,
                                                           first * 16 + static_cast<std::uint32_t>(n),
                                                           position(at[3]) * 16 + second,
                                                           scale_here / 2 * 16 + scale / 2,
                                                           third * 16 + first};
    for (std::size_t i = 0; i < kBeyondContexts; ++i) slots[i] = kBeyondBegins[i] + of[i];
  }
};

}  // namespace lidarcodec
