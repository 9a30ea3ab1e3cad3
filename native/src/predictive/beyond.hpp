// Returns beyond the last leaf, in kinds with a network. The last return predicts them badly, so they are coded as
// differences from another neighbour.
//
// The neighbours beyond the last leaf on the same side are the *anchors*, the likeliest first. A second tree of 16
// leaves lies around the first anchor, with a scale of its own. Its contexts are made of the positions of the other
// anchors.
#pragma once
#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>

#include "bits/cells.hpp"
#include "predictive/model.hpp"
#include "predictive/positions.hpp"

namespace lidarcodec {

inline constexpr std::size_t kAnchors = 10;
inline constexpr std::array<std::int16_t, 4> kBeyondRates = {1440, 920, 640,
                                                             460};  // twice kContextRates: such returns are few

// The second tree of a return: where it lies, and the slots of its contexts.
struct BeyondTree {
  std::int32_t anchor;  // distance of the first anchor, in cells; differences are counted from it
  std::uint32_t scale;
  std::array<std::uint32_t, kBeyondContexts> slots;

  // candidates: neighbours, sixteenths of a cell, the likeliest first. origin: the lower end of the base's cell; down:
  // whether the return lies below it. begin: its least distance, in cells. scale_here: the scale class of the first
  // tree.
  BeyondTree(const std::array<std::int32_t, kAnchors>& candidates, std::int32_t origin, bool down, std::int32_t begin,
             std::uint32_t scale_here) {
    const std::int32_t sign = down ? -1 : 0;
    std::array<std::int32_t, kAnchors> anchors{};
    std::size_t n = 0;
    std::uint32_t owner = 0;
    for (std::size_t i = 0; i < kAnchors; ++i) {
      const std::int32_t away = ((candidates[i] - origin) >> kDifferenceBits) ^ sign;
      if (away < begin) continue;
      if (n == 0) owner = static_cast<std::uint32_t>(i) + 1;
      anchors[n++] = away;
    }
    // Without an anchor the tree lies four first octaves away, at most 4096 cells.
    if (n == 0) anchors[0] = begin + std::min(4 << kBeyondBits[scale_here], 4096);
    for (std::size_t i = std::max<std::size_t>(n, 1); i < 4; ++i) anchors[i] = anchors[i - 1];
    anchor = anchors[0];
    // The scale is that of half the mean distance of two more anchors from the first, plus half a cell. Without another
    // anchor it is four classes, a factor of 4, above that of the first tree. It is at most two classes, a factor of 2,
    // below it.
    scale =
        n < 2 ? std::min(scale_here + 4, kScaleClasses - 1)
              : scale_class((difference(16 * (anchors[1] - anchor)) + difference(16 * (anchors[2] - anchor))) / 4 + 8);
    scale = std::max(scale, scale_here > 2 ? scale_here - 2 : 0);
    const auto position = [&](std::int32_t other) {
      return static_cast<std::uint32_t>(PlainPositions::position_of(4 * (other - anchor), scale));
    };
    const std::uint32_t first = position(begin), second = position(anchors[1]), third = position(anchors[2]);
    const std::array<std::uint32_t, kBeyondContexts> of = {scale * 16 + owner,
                                                           second * 16 + third,
                                                           first * 16 + static_cast<std::uint32_t>(n),
                                                           position(anchors[3]) * 16 + second,
                                                           scale_here / 2 * 16 + scale / 2,
                                                           third * 16 + first};
    for (std::size_t i = 0; i < kBeyondContexts; ++i) slots[i] = kBeyondBegins[i] + of[i];
  }
};

}  // namespace lidarcodec
