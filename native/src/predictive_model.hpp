// What is known of a return before its range is coded, and the models that each piece of it names.
//
// Ranges are coded as differences from the last return of the row. Around it are others: earlier ones of the row, and
// those of the two rows above, also further on. Where each of them lies, as seen from the last one and measured by how
// much ranges differ here, is its *position*, 0 to 15. Two or three positions, or one and a class, make a context. Each
// context has a tree of 16 leaves whose log odds are added up (cells.hpp), so that few returns teach much.
#pragma once
#include <algorithm>
#include <array>
#include <bit>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "cells.hpp"
#include "positions.hpp"
#include "predictive_tables.hpp"

namespace lidarcodec {

// Classes of half octaves: 2 log2 of a number, rounded down; 0 for 0.
inline std::uint32_t half_octaves(std::uint32_t x) {
  if (x == 0) return 0;
  const auto octave = static_cast<std::uint32_t>(std::bit_width(x)) - 1;
  const std::uint64_t square = std::uint64_t{x} * x;
  return 2 * octave + static_cast<std::uint32_t>(square >> (2 * octave + 1) & 1);
}

// Differences are kept in sixteenths of a cell.
inline constexpr std::uint32_t kDifferenceBits = 4;
inline constexpr std::uint32_t kMaxDifference = 1u << 20;

inline std::uint32_t difference(std::int32_t cells) {
  const std::uint32_t size = cells < 0 ? 0u - static_cast<std::uint32_t>(cells) : static_cast<std::uint32_t>(cells);
  return std::min(size << kDifferenceBits, kMaxDifference);
}

// Scale class (predictive_tables.hpp) of a mean difference.
inline std::uint32_t scale_class(std::uint32_t mean) {
  const std::uint32_t class_of = half_octaves(mean + 2);
  return std::min(class_of - std::min(class_of, 1u), kScaleClasses - 1);
}

// What has a class or a position of 16. First the positions, in the order of positions.hpp.
enum Feature : std::uint8_t {
  kLast2, kLast3, kLast4, kLast5,                              // the returns before the last one
  kUpLeft, kUp, kUpRight, kUpRight2,                           // the row above, levelled
  kUpLeftPlain, kUpPlain, kUpRightPlain, kUpRight2Plain,       // the row above as it is
  kSlope, kSlopeOn, kSlopeOn2, kSlopeOn3,                      // slopes of the row above
  kSlopeMean, kSlopeMeanOn, kSlopeMeanOn2, kSlopeMeanOn3,      // over two cells
  kUpperLeft, kUpper, kUpperRight, kUpperRight2,               // the second row above as it is
  kStepLeft, kStep, kStepRight, kStepRight2,                   // the same as seen from the row above
  kUpperSlope, kUpperSlopeOn, kUpperSlopeOn2, kUpperSlopeOn3,  // its slopes
  kScale, kMask, kMeanSize, kLastSize, kUpSize, kLastLeaf,
  kFeatures,
  // Of frames that know what to expect:
  kSeenLeft = kFeatures, kSeen, kSeenRight, kSeenRight2,       // what is expected, corrected by what came before
  kSeenLeftPlain, kSeenPlain, kSeenRightPlain, kSeenRight2Plain,
  kSeenSlope, kSeenSlopeOn, kSeenSlopeOn2, kSeenSlopeOn3,
  kSurpriseLeft, kSurprise, kSurpriseRight, kSurpriseRight2,   // what came in the row above against what was expected
  kSeenMask, kSeenSize,
  kAllFeatures
};
static_assert(kScale == kPositionLanes && kSeenMask == kSeenLeft + kExpectedLanes);

// A context of two features (256 slots of 16 x 16) or three (512 of 8 x 8 x 8).
struct Context {
  Feature a, b, c = kAllFeatures;
};
inline constexpr std::array<Context, 9> kContextsOfFeatures = {{
    {kLast3, kLast4},
    {kUpPlain, kMeanSize},
    {kLast2, kLast5},
    {kMask, kSlopeOn, kUpRight2},
    {kScale, kLast2},
    {kUpperRight, kMask, kLast3},
    {kUpperSlopeOn, kUpRightPlain},
    {kSlopeMeanOn3, kLast2},
    {kLastLeaf, kLastSize, kLast5},
}};
inline constexpr std::size_t kFixedContexts = 4;  // scale; last two leaves; mask; level above and scale
inline constexpr std::array<Context, 6> kContextsOfExpected = {{
    {kSeenLeftPlain, kSeenSlope},
    {kSeen, kSeenSlopeOn, kLast2},
    {kSeenRight, kSeenRightPlain},
    {kSeenRight2, kSeenSlopeOn3, kMask},
    {kSeenPlain, kSurpriseRight, kScale},
    {kSeenPlain, kSeen},
}};
inline constexpr std::size_t kPredictiveContexts = kFixedContexts + kContextsOfFeatures.size();
inline constexpr std::size_t kAllContexts = kPredictiveContexts + kContextsOfExpected.size();

inline constexpr std::uint32_t kMaskContexts = 512;

// A slot: 16 cells, of which the first counts how often the context was seen, and the others are nodes 1 to 15 of a tree.
inline constexpr std::uint32_t kSlotCells = 16;
using Slots = std::array<std::int16_t*, kAllContexts>;

// Decisions beyond the tree: where in its leaf a difference lies, and how far beyond the last leaf.
struct OffsetCells {
  static constexpr std::uint32_t kDepth = 3;
  std::array<std::int16_t, 5 * 4 * 32> near{};                     // [what a neighbour says][depth][leaf, side, beyond]
  std::array<std::int16_t, kScaleClasses * 8 * 4> leaf{};          // [scale][leaf][depth]
  std::array<std::int16_t, 32 * 128> more{};                       // [octave][who is here, who beyond]
  std::array<std::int16_t, kScaleClasses * 32> more_of_scale{};    // [scale][octave]
};

class PredictiveModel {
 public:
  PredictiveModel() { reset(); }

  void reset() {
    std::uint32_t total = 0;
    const auto take = [&](std::size_t context, std::uint32_t slots) {
      begin_[context] = total * kSlotCells;
      total += slots;
    };
    take(0, kScaleClasses);
    take(1, 256);
    take(2, kMaskContexts);
    take(3, 16 * kScaleClasses);
    for (std::size_t i = 0; i < kContextsOfFeatures.size(); ++i)
      take(kFixedContexts + i, kContextsOfFeatures[i].c == kAllFeatures ? 256 : 512);
    for (std::size_t i = 0; i < kContextsOfExpected.size(); ++i)
      take(kPredictiveContexts + i, kContextsOfExpected[i].c == kAllFeatures ? 256 : 512);
    cells_.assign(total * kSlotCells, 0);
    for (std::uint32_t c = 0; c < kScaleClasses; ++c)
      std::copy_n(kFirstLogOdds[c], kSlotCells, cells_.data() + begin_[0] + c * kSlotCells);
    offsets = {};
  }

  // The slots of a return, those of expectations only if there are any. `leaves`: of the last two returns, the later one
  // in the higher bits.
  template <bool kExpects>
  void find(const std::array<std::uint8_t, kAllFeatures>& of, std::uint32_t scale, std::uint32_t leaves,
            std::uint32_t mask, Slots& found) {
    std::int16_t* const cells = cells_.data();
    const auto name = [&](std::size_t context, std::uint32_t slot) {
      found[context] = cells + begin_[context] + slot * kSlotCells;
    };
    const auto slot_of = [&](const Context& context) {
      return context.c == kAllFeatures
                 ? of[context.a] * 16u + of[context.b]
                 : (of[context.a] >> 1) * 64u + (of[context.b] >> 1) * 8u + (of[context.c] >> 1);
    };
    name(0, scale);
    name(1, leaves);
    name(2, mask);
    name(3, of[kUp] * kScaleClasses + scale);
#pragma GCC unroll 16
    for (std::size_t i = 0; i < kContextsOfFeatures.size(); ++i)
      name(kFixedContexts + i, slot_of(kContextsOfFeatures[i]));
    if constexpr (kExpects) {
#pragma GCC unroll 16
      for (std::size_t i = 0; i < kContextsOfExpected.size(); ++i)
        name(kPredictiveContexts + i, slot_of(kContextsOfExpected[i]));
    }
  }

  OffsetCells offsets;

 private:
  std::vector<std::int16_t> cells_;
  std::array<std::uint32_t, kAllContexts> begin_{};
};

}  // namespace lidarcodec
