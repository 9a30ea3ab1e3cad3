// The contexts of a return, and the models that they select.
//
// Ranges are coded as differences from the last return of the row (DPCM). Its causal neighbours are earlier returns of
// the row, and cells of the two rows above to the left and to the right. The *position* of a neighbour, 0 to 15, is its
// difference from the last return, quantised in units of the local scale. The local scale is the mean size of the
// differences nearby, as the error energy of CALIC (Wu and Memon, "Context-based, adaptive, lossless image coding",
// 1997). A context is made of two or three positions or classes. Each context has a tree of 16 leaves. A logistic
// regression adds the log odds of all contexts (native/src/bits/README.md, Cells).
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

// floor(2 log2 x), the class of a half octave; 0 for 0. A number is in the upper half of its octave if its square is at
// least 2^(2 octave + 1).
inline std::uint32_t half_octaves(std::uint32_t x) {
  if (x == 0) return 0;
  const auto octave = static_cast<std::uint32_t>(std::bit_width(x)) - 1;
  const std::uint64_t square = std::uint64_t{x} * x;
  return 2 * octave + static_cast<std::uint32_t>(square >> (2 * octave + 1) & 1);
}

// Differences are in sixteenths of a cell, and saturate at 2^20: 65536 cells, more than any range has.
inline constexpr std::uint32_t kDifferenceBits = 4;
inline constexpr std::uint32_t kMaxDifference = 1u << 20;

inline std::uint32_t difference(std::int32_t sixteenths) {
  const std::uint32_t size =
      sixteenths < 0 ? 0u - static_cast<std::uint32_t>(sixteenths) : static_cast<std::uint32_t>(sixteenths);
  return std::min(size, kMaxDifference);
}

// Scale class (predictive/tables.hpp) of a mean difference.
inline std::uint32_t scale_class(std::uint32_t mean) {
  const std::uint32_t class_of = half_octaves(mean + 2);
  return std::min(class_of - std::min(class_of, 1u), kScaleClasses - 1);
}

// The features of a return, each 0 to 15: 32 positions (predictive/positions.hpp), 8 classes, and 16 positions of
// expected ranges from number 48 on. kX, kXOn, kXOn2 are features of the cells to the right of one another.
enum Feature : std::uint8_t {
  kLast2,
  kLast3,
  kLast4,
  kLast5,  // the returns before the last one
  kUpLeft,
  kUp,
  kUpRight,
  kUpRight2,  // the row above, corrected by the level
  kUpLeftPlain,
  kUpPlain,
  kUpRightPlain,
  kUpRight2Plain,  // the row above, not corrected
  kGradient,
  kGradientOn,
  kGradientOn2,
  kGradientOn3,  // gradients of the row above, from a cell to the next
  kCentral,
  kCentralOn,
  kCentralOn2,
  kCentralOn3,  // central differences of the row above
  kUpperLeft,
  kUpper,
  kUpperRight,
  kUpperRight2,  // the second row above
  kVerticalLeft,
  kVertical,
  kVerticalRight,
  kVerticalRight2,  // vertical gradients: the second row above minus the row above
  kUpperGradient,
  kUpperGradientOn,
  kUpperGradientOn2,
  kUpperGradientOn3,  // gradients of the second row above
  kScale,
  kMask,
  kLastLeaf,
  kExpectedMask,  // half the scale; mask of four neighbours; last leaf; where ranges are expected
  kMeanSize,
  kLastSize,
  kUpSize,
  kExpectedSize,  // classes of differences, relative to the scale
  // Only with expected ranges:
  kExpectedLeft = 48,
  kExpected,
  kExpectedRight,
  kExpectedRight2,  // expected ranges, corrected by the bias
  kExpectedLeftPlain,
  kExpectedPlain,
  kExpectedRightPlain,
  kExpectedRight2Plain,
  kExpectedGradient,
  kExpectedGradientOn,
  kExpectedGradientOn2,
  kExpectedGradientOn3,
  kResidualLeft,
  kResidual,
  kResidualRight,
  kResidualRight2,  // residuals of the row above: ranges minus expected ones
  kFeatures
};
static_assert(kScale == kPositionLanes && kFeatures == kExpectedLeft + kExpectedLanes);
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
    {kMask, kGradientOn, kUpRight2},
    {kScale, kLast2},
    {kUpperRight, kMask, kLast3},
    {kUpperGradientOn, kUpRightPlain},
    {kCentralOn3, kLast2},
    {kLastLeaf, kLastSize, kLast5},
}};
inline constexpr std::size_t kFixedContexts = 5;  // scale; last two leaves; mask; kUp and scale; row and firing
inline constexpr std::array<Context, 6> kContextsOfExpected = {{
    {kExpectedLeftPlain, kExpectedGradient},
    {kExpected, kExpectedGradientOn, kLast2},
    {kExpectedRight, kExpectedRightPlain},
    {kExpectedRight2, kExpectedGradientOn3, kMask},
    {kExpectedPlain, kResidualRight, kScale},
    {kExpectedPlain, kExpected},
}};
constexpr Context context_of_features(std::size_t i) {
  return i < kContextsOfFeatures.size() ? kContextsOfFeatures[i] : kContextsOfExpected[i - kContextsOfFeatures.size()];
}
inline constexpr std::size_t kPredictiveContexts = kFixedContexts + kContextsOfFeatures.size();
inline constexpr std::size_t kAllContexts = kPredictiveContexts + kContextsOfExpected.size();

// kFirst: the contexts of all but quick kinds, 0 to count - 1. kQuickAlone and kQuickExpecting: the contexts of quick
// kinds, without and with expected ranges (research/notes/fewer-contexts.md).
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
// Period of the sensor's range errors, in firings: the least common multiple of the periods 3, 12, 2.4 and 24 in its
// error spectrum.
inline constexpr std::uint32_t kFirings = 24;

// Slots of the context of row and firing.
inline constexpr std::uint32_t kFiringSlots = static_cast<std::uint32_t>(kMaskRows) * kFirings;

// The cells of one context: number 0 counts how often it was seen (kCountSteps), numbers 1 to 15 are the log odds of
// the tree's nodes.
inline constexpr std::uint32_t kSlotCells = 16;
struct alignas(32) Slot {
  std::array<std::int16_t, kSlotCells> cells{};
};

// First cell of each context; then the number of all cells.
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

// First cell of the slot of each context. The array is padded to whole vectors.
struct alignas(32) Slots {
  std::array<std::uint32_t, kFixedContexts + 16> of;
};
static_assert(kAllContexts < std::tuple_size_v<decltype(Slots::of)>);

// Cells of the decisions after the tree: the offset in a leaf, and the octave beyond the last leaf.
struct OffsetCells {
  static constexpr std::uint32_t kDepth = 4;    // modelled bits of an offset, at most
  std::array<std::int16_t, 5 * 4 * 32> near{};  // [prediction of a neighbour][depth][leaf and side; 16: beyond]
  std::array<std::int16_t, kScaleClasses * 8 * 4> leaf{};        // [scale][leaf][depth]
  std::array<std::int16_t, 32 * 128> more{};                     // [octave][neighbours in this octave and beyond it]
  std::array<std::int16_t, kScaleClasses * 32> more_of_scale{};  // [scale][octave]
};

// Contexts of returns beyond the last leaf, in kinds with a network (predictive/beyond.hpp).
inline constexpr std::size_t kBeyondContexts = 6;
// First slot of each context; then the number of all slots. The first has 32 scales x 16, the others 16 x 16.
inline constexpr std::array<std::uint32_t, kBeyondContexts + 1> kBeyondBegins = {0, 512, 768, 1024, 1280, 1536, 1792};

struct BeyondCells {
  static constexpr std::uint32_t kDepth = 3;
  std::array<Slot, kBeyondBegins.back()> slots{};
  std::array<std::int16_t, kDepth * kScaleClasses * 16> offset{};  // offset bits: [depth][scale][leaf]
  std::array<std::int16_t, kScaleClasses> of_scale{};  // octaves beyond the last leaf of the second tree: [scale]
  std::array<std::int16_t, 2 * kScaleClasses> more{};  // the same: [octave][side]
};

// Weights of logistic mixing (Mahoney 2005) of the log odds of a network and of the contexts, for each node; 16384
// stands for 1. The contexts begin at 0.9, since contexts that learn from noise are overconfident.
struct alignas(32) MixingWeights {
  static constexpr std::int16_t kOne14 = 1 << 14;  // weight 1
  std::array<std::int16_t, kSlotCells> of_net, of_contexts;
  constexpr MixingWeights() {
    of_net.fill(kOne14);
    of_contexts.fill((9 * kOne14 + 5) / 10);
  }
};

// What the contexts of a return are made of.
struct Known {
  Neighbours around;
  Expected expected;  // only with expected ranges
  std::uint32_t scale = 0;
  std::uint32_t leaves = 0;   // leaves of the last two returns, the later one in the upper four bits
  std::uint32_t firing = 0;   // slot of the context of firings
  std::uint32_t returns = 0;  // neighbours that are returns: bits 0 to 8 are context 2; bits 9 to 11: whether a range
                              // is expected to the left, to the right and here; bits 12 to 15: kMask
  std::uint32_t mean_size = 0, last_size = 0, up_size = 0, seen_size = 0;  // differences
};

class PredictiveModel {
 public:
  // network: a network gives the prior; the cells of the scale context then begin at 0.
  explicit PredictiveModel(bool network = false) : network_(network) { reset(); }

  void reset() {
    slots_.assign(kContextBegins[kAllContexts] / kSlotCells, {});
    const auto& first = quick_ ? kQuickFirstLogOdds : kFirstLogOdds;
    for (std::uint32_t c = 0; c < kScaleClasses && !network_; ++c)
      std::copy_n(first[c], kSlotCells, slots_[c].cells.data());
    offsets = {};
    beyond = {};
    mixing_weights = {};
  }

  // Begins an image. Quick kinds have other leaves, so a change of quick resets the models.
  void begin(bool quick) {
    if (quick == quick_) return;
    quick_ = quick;
    reset();
  }

  // The cells of all slots.
  std::int16_t* cells() { return slots_.data()->cells.data(); }

  OffsetCells offsets;
  BeyondCells beyond;
  std::array<MixingWeights, kScaleClasses> mixing_weights{};  // only with a network

 private:
  bool network_, quick_ = false;
  std::vector<Slot> slots_;
};

}  // namespace lidarcodec
