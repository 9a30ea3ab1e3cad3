// What is known of a return before its range is coded, and the models that each piece of it names.
//
// Ranges are coded as differences from the last return of the row. Around it are others: earlier ones of the row, and
// those of the two rows above, also further on. Where each of them lies, as seen from the last one and measured by how
// much ranges differ here, is its *position*, 0 to 15. Two or three positions, or one and a class, make a context. Each
// context has a tree of 16 leaves whose log odds are added up (bits/cells.hpp), so that few returns teach much.
#pragma once
#include <algorithm>
#include <array>
#include <bit>
#include <cstddef>
#include <cstdint>
#include <tuple>
#include <vector>

#include "bits/cells.hpp"
#include "mask/coder.hpp"
#include "predictive/positions.hpp"
#include "predictive/tables.hpp"

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

inline std::uint32_t difference(std::int32_t sixteenths) {
  const std::uint32_t size = sixteenths < 0 ? 0u - static_cast<std::uint32_t>(sixteenths) : static_cast<std::uint32_t>(sixteenths);
  return std::min(size, kMaxDifference);
}

// Scale class (predictive/tables.hpp) of a mean difference.
inline std::uint32_t scale_class(std::uint32_t mean) {
  const std::uint32_t class_of = half_octaves(mean + 2);
  return std::min(class_of - std::min(class_of, 1u), kScaleClasses - 1);
}

// What has a class or a position of 16. Four blocks of 16: positions as in predictive/positions.hpp; classes; positions of what is
// expected.
enum Feature : std::uint8_t {
  kLast2, kLast3, kLast4, kLast5,                              // the returns before the last one
  kUpLeft, kUp, kUpRight, kUpRight2,                           // the row above, levelled
  kUpLeftPlain, kUpPlain, kUpRightPlain, kUpRight2Plain,       // the row above as it is
  kSlope, kSlopeOn, kSlopeOn2, kSlopeOn3,                      // slopes of the row above
  kSlopeMean, kSlopeMeanOn, kSlopeMeanOn2, kSlopeMeanOn3,      // over two cells
  kUpperLeft, kUpper, kUpperRight, kUpperRight2,               // the second row above as it is
  kStepLeft, kStep, kStepRight, kStepRight2,                   // the same as seen from the row above
  kUpperSlope, kUpperSlopeOn, kUpperSlopeOn2, kUpperSlopeOn3,  // its slopes
  kScale, kMask, kLastLeaf, kSeenMask,                         // half the scale; returns around; of them, the expected
  kMeanSize, kLastSize, kUpSize, kSeenSize,                    // differences as seen from the scale
  // Of frames that know what to expect:
  kSeenLeft = 48, kSeen, kSeenRight, kSeenRight2,              // what is expected, corrected by what came before
  kSeenLeftPlain, kSeenPlain, kSeenRightPlain, kSeenRight2Plain,
  kSeenSlope, kSeenSlopeOn, kSeenSlopeOn2, kSeenSlopeOn3,
  kSurpriseLeft, kSurprise, kSurpriseRight, kSurpriseRight2,   // what came in the row above against what was expected
  kFeatures
};
static_assert(kScale == kPositionLanes && kFeatures == kSeenLeft + kExpectedLanes);
using Features = std::array<std::uint8_t, kFeatures>;

// A context of two features (256 slots of 16 x 16) or three (512 of 8 x 8 x 8).
struct Context {
  Feature a, b, c = kFeatures;
  constexpr bool is_pair() const { return c == kFeatures; }
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
inline constexpr std::size_t kFixedContexts = 5;  // scale; last two leaves; mask; level above and scale; row and firing
inline constexpr std::array<Context, 6> kContextsOfExpected = {{
    {kSeenLeftPlain, kSeenSlope},
    {kSeen, kSeenSlopeOn, kLast2},
    {kSeenRight, kSeenRightPlain},
    {kSeenRight2, kSeenSlopeOn3, kMask},
    {kSeenPlain, kSurpriseRight, kScale},
    {kSeenPlain, kSeen},
}};
constexpr Context context_of_features(std::size_t i) {
  return i < kContextsOfFeatures.size() ? kContextsOfFeatures[i] : kContextsOfExpected[i - kContextsOfFeatures.size()];
}
inline constexpr std::size_t kPredictiveContexts = kFixedContexts + kContextsOfFeatures.size();
inline constexpr std::size_t kAllContexts = kPredictiveContexts + kContextsOfExpected.size();

// Numbers of the contexts of frames alone, and of those that expect something: of all kinds but quick ones, and of those,
// which do nearly as well with fewer (research/notes/fewer-contexts.md).
template <std::size_t count>
inline constexpr auto kFirst = [] {
  std::array<std::uint8_t, count> numbers{};
  for (std::size_t i = 0; i < count; ++i) numbers[i] = static_cast<std::uint8_t>(i);
  return numbers;
}();
inline constexpr std::array<std::uint8_t, 11> kQuickAlone = {0, 1, 4, 5, 6, 8, 9, 10, 11, 12, 13};
inline constexpr std::array<std::uint8_t, 13> kQuickExpecting = {0, 1, 4, 5, 6, 9, 10, 13, 14, 15, 16, 17, 18};

template <bool kExpects>
constexpr const auto& all_contexts() {
  if constexpr (kExpects) {
    return kFirst<kAllContexts>;
  } else {
    return kFirst<kPredictiveContexts>;
  }
}
template <bool kExpects>
constexpr const auto& quick_contexts() {
  if constexpr (kExpects) {
    return kQuickExpecting;
  } else {
    return kQuickAlone;
  }
}

inline constexpr std::uint32_t kMaskContexts = 512;
// Firings after which the sensor's errors come again: they have periods of 3, 12, 2.4 and 24 firings.
inline constexpr std::uint32_t kFirings = 24;

// Slots of the context of firings.
inline constexpr std::uint32_t kFiringSlots = static_cast<std::uint32_t>(kMaskRows) * kFirings;

// A slot: 16 cells, of which the first counts how often the context was seen (kSeenOnce), and the others are nodes 1 to 15 of a tree.
inline constexpr std::uint32_t kSlotCells = 16;
struct alignas(32) Slot {
  std::array<std::int16_t, kSlotCells> cells{};
};

// First cell of each context's slots; then how many cells there are.
inline constexpr auto kContextBegins = [] {
  std::array<std::uint32_t, kAllContexts + 1> begins{};
  for (std::size_t i = 0; i < kAllContexts; ++i) {
    std::uint32_t slots = 256;
    if (i == 0) slots = kScaleClasses;
    if (i == 2) slots = kMaskContexts;
    if (i == 3) slots = 16 * kScaleClasses;
    if (i == 4) slots = kFiringSlots;
    if (i >= kFixedContexts) slots = context_of_features(i - kFixedContexts).is_pair() ? 256 : 512;
    begins[i + 1] = begins[i] + slots * kSlotCells;
  }
  return begins;
}();

// First cell of the slot of each context; room for whole vectors.
struct alignas(32) Slots {
  std::array<std::uint32_t, kFixedContexts + 16> of;
};
static_assert(kAllContexts < std::tuple_size_v<decltype(Slots::of)>);

// Decisions beyond the tree: where in its leaf a difference lies, and how far beyond the last leaf.
struct OffsetCells {
  static constexpr std::uint32_t kDepth = 4;  // at most so many bits of an offset learn
  std::array<std::int16_t, 5 * 4 * 32> near{};                     // [what a neighbour says][depth][leaf, side, beyond]
  std::array<std::int16_t, kScaleClasses * 8 * 4> leaf{};          // [scale][leaf][depth]
  std::array<std::int16_t, 32 * 128> more{};                       // [octave][who is here, who beyond]
  std::array<std::int16_t, kScaleClasses * 32> more_of_scale{};    // [scale][octave]
};

// Of returns beyond the last leaf, where a network says what is likely (predictive/beyond.hpp).
inline constexpr std::size_t kBeyondContexts = 6;
// First slot of each context; then how many slots there are.
inline constexpr std::array<std::uint32_t, kBeyondContexts + 1> kBeyondBegins = {0, 512, 768, 1024, 1280, 1536, 1792};

struct BeyondCells {
  static constexpr std::uint32_t kDepth = 3;
  std::array<Slot, kBeyondBegins.back()> slots{};
  std::array<std::int16_t, kDepth * kScaleClasses * 16> offset{};  // [depth][scale][leaf]: offset bits
  std::array<std::int16_t, kScaleClasses> of_scale{};        // beyond the last leaf of this tree, too
  std::array<std::int16_t, 2 * kScaleClasses> more{};        // [octave][side]
};

// How much what a network says and what contexts say counts at each node, 16384 for as it is. Contexts say too much where
// they learn mostly noise, by how much depends on the step and the sensor.
struct alignas(32) Balance {
  std::array<std::int16_t, kSlotCells> of_net, of_contexts;
  constexpr Balance() {
    of_net.fill(16384);
    of_contexts.fill(14746);
  }
};

// What is known of a return.
struct Known {
  Around around;
  Expected expected;          // where something is expected
  std::uint32_t scale = 0;
  std::uint32_t leaves = 0;   // of the last two returns, the later one in the higher bits
  std::uint32_t firing = 0;   // slot of the context of firings
  std::uint32_t returns = 0;  // around: bits 0 to 8 are a context, 9 to 11 what is expected to the left, to the right and here, 12 to 15 kMask
  std::uint32_t mean_size = 0, last_size = 0, up_size = 0, seen_size = 0;  // differences
};

class PredictiveModel {
 public:
  // learned: a network says what is likely to begin with.
  explicit PredictiveModel(bool learned = false) : learned_(learned) { reset(); }

  void reset() {
    slots_.assign(kContextBegins[kAllContexts] / kSlotCells, {});
    const auto& first = quick_ ? kQuickFirstLogOdds : kFirstLogOdds;
    for (std::uint32_t c = 0; c < kScaleClasses && !learned_; ++c) std::copy_n(first[c], kSlotCells, slots_[c].cells.data());
    offsets = {};
    beyond = {};
    balance = {};
  }

  // Before an image, whether of a quick kind: trees have other leaves there, of which nothing is known then.
  void begin(bool quick) {
    if (quick == quick_) return;
    quick_ = quick;
    reset();
  }

  // Of all slots.
  std::int16_t* cells() { return slots_.data()->cells.data(); }

  OffsetCells offsets;
  BeyondCells beyond;
  std::array<Balance, kScaleClasses> balance{};  // where a network says what is likely

 private:
  bool learned_, quick_ = false;
  std::vector<Slot> slots_;
};

}  // namespace lidarcodec
