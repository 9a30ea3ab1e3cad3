// Rows of ranges: what is coded when, and how models learn from it.
#pragma once
#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>
#include <type_traits>
#include <vector>

#include "cells.hpp"
#include "error.hpp"
#include "predictive_model.hpp"
#include "wide_coder.hpp"

namespace lidarcodec {

// What a row is coded with: its own no returns, and the rows around as seen from it, all with margins.
struct RowSurroundings {
  const std::uint8_t *here, *above_mask, *below_mask;  // 0 and 1
  const std::int32_t* above;                           // ranges; nullptr for the first row
  const std::int32_t* upper;                           // the row above that; nullptr for the first two
  const std::uint32_t* sizes;                          // differences in the row above
  // Where something is expected: ranges, filled from the left where nothing is, and whether something is.
  const std::int32_t *expected = nullptr, *expected_above = nullptr;
  const std::uint8_t* known = nullptr;
};

// One half of each row: its coder, and what is known from the returns before.
template <class Coder>
struct PredictiveHalf {
  Coder coder;
  WideInterval interval{};
  std::size_t next = 0;                                  // return of the row
  bool begun = false;                                    // whether there was a return
  std::array<std::int32_t, 8> last{};                    // ranges, the latest first
  std::uint32_t size1 = 0, size2 = 0, mean = 0;          // the last difference, the weighted one before, a long mean
  std::int32_t level = 0;                                // of this row above the one above, sixteenths
  std::int32_t bias = 0;                                 // of what comes above what is expected, sixteenths
  std::uint32_t miss = 0;                                // mean difference from what is expected
  std::uint32_t leaves = 0x88;                           // of the last two returns

  void begin(std::size_t first, std::uint32_t start) {
    next = first;
    begun = false;
    size1 = size2 = mean = start;
    level = bias = 0;
    miss = start;
    leaves = 0x88;
  }
};

// How fast a context learns, by how often it was seen: less than 6, 24, 96 times, and more.
inline constexpr std::array<std::int16_t, 4> kPredictiveRates = {720, 460, 320, 230};
inline constexpr auto kRateOfCount = [] {
  std::array<std::uint8_t, 97> rate{};
  for (std::size_t n = 0; n < rate.size(); ++n) rate[n] = static_cast<std::uint8_t>((n >= 6) + (n >= 24) + (n >= 96));
  return rate;
}();
alignas(16) inline constexpr std::array<std::int16_t, 8> kSeenOnce = {1};
inline constexpr std::int32_t kOffsetRate = 655;
inline constexpr std::uint32_t kMaxOctaves = 16;  // beyond the last leaf: more than any range

// Distance from the last return at which each leaf begins.
inline constexpr auto kLeafBegins = [] {
  std::array<std::array<std::uint32_t, 8>, kScaleClasses> begins{};
  for (std::size_t c = 0; c < kScaleClasses; ++c)
    for (std::size_t l = 1; l < 8; ++l) begins[c][l] = begins[c][l - 1] + (1u << kLeafBits[c][l - 1]);
  return begins;
}();

// Codes rows of ranges; `Coder` is WideEncoder or WideDecoder. The two halves of a row take turns, a return each.
template <class Coder, bool kExpects>
class PredictiveRows {
 public:
  static constexpr bool kReads = std::is_same_v<Coder, WideDecoder>;
  using Halves = std::array<PredictiveHalf<Coder>, 2>;

  // step: native range steps in a cell; limit: largest range, in cells.
  PredictiveRows(PredictiveModel& model, std::uint32_t step, std::int32_t limit, Halves& halves)
      : model_(model), start_(480 / step + 5), first_(static_cast<std::int32_t>(2500 / step)), limit_(limit), halves_(halves) {}

  // Writes or reads the ranges of a row's returns, whose cells are `cells[0]` to `cells[n - 1]`. `sizes` takes what
  // each differs by. Raises Section or Truncated.
  void code(const RowSurroundings& about, const std::vector<std::uint32_t>& cells, std::size_t n, std::int32_t* ranges,
            std::uint32_t* sizes) {
    const std::size_t half = (n + 1) / 2;
    for (std::size_t h = 0; h < 2; ++h) {
      halves_[h].begin(h == 0 ? 0 : half, start_);
      if constexpr (!kReads) halves_[h].coder.make_room(half * kMostDecisions);
    }
    for (std::size_t i = half; i < n; ++i) step<2>(about, cells, ranges, sizes);
    if (n % 2 != 0) step<1>(about, cells, ranges, sizes);
  }

  std::uint32_t start() const { return start_; }  // difference to begin with
  std::int32_t first() const { return first_; }   // range to begin with

 private:
  static constexpr std::size_t kMostDecisions = 4 + OffsetCells::kDepth + kMaxOctaves + 3;
  static constexpr std::size_t kNeighbours = 8;
  static constexpr std::size_t kUsed = kExpects ? kAllContexts : kPredictiveContexts;

  // A return about to be coded.
  struct Place {
    std::uint32_t cell, scale;
    std::int32_t base;                               // where differences are counted from
    std::array<std::int32_t, kNeighbours> near;      // ranges around, the likeliest first
    Slots slots;
  };

  template <std::size_t N>
  void step(const RowSurroundings& about, const std::vector<std::uint32_t>& cells, std::int32_t* ranges,
            std::uint32_t* sizes) {
    std::array<Place, N> place;
    std::array<std::array<Cells, 2>, N> p;
    alignas(16) std::array<std::array<std::int16_t, 16>, N> chance;
    std::array<std::uint32_t, N> node;
    std::array<std::uint32_t, N> leaf{}, away{};
    for (std::size_t h = 0; h < N; ++h) {
      look(halves_[h], about, cells[halves_[h].next], place[h]);
      const Slots& s = place[h].slots;
      for (std::size_t v = 0; v < 2; ++v) {
        Cells sum = Cells::load(s[0] + 8 * v);
#pragma GCC unroll 16
        for (std::size_t i = 1; i < kUsed; ++i) sum = sum + Cells::load(s[i] + 8 * v);
        p[h][v] = probabilities(sum);
        p[h][v].store(chance[h].data() + 8 * v);
      }
      node[h] = 1;
      if constexpr (!kReads) {
        const std::int32_t d = ranges[place[h].cell] - place[h].base;
        away[h] = static_cast<std::uint32_t>(d < 0 ? -1 - d : d);
        const std::uint32_t l = leaf_of(place[h].scale, away[h]);
        leaf[h] = d < 0 ? 7 - l : 8 + l;
      }
    }
#pragma GCC unroll 4
    for (int level = 3; level >= 0; --level) {
#pragma GCC unroll 2
      for (std::size_t h = 0; h < N; ++h) {
        const auto probability = static_cast<std::uint32_t>(chance[h][node[h]]);
        std::uint32_t bit;
        if constexpr (kReads) {
          bit = halves_[h].coder.decode(halves_[h].interval, probability);
        } else {
          bit = leaf[h] >> level & 1u;
          halves_[h].coder.encode(halves_[h].interval, bit, probability);
        }
        node[h] = 2 * node[h] + bit;
      }
    }
    for (std::size_t h = 0; h < N; ++h) {
      learn(place[h].slots, p[h], kWalks[node[h]]);
      PredictiveHalf<Coder>& half = halves_[h];
      const std::uint32_t came = node[h] - 16;
      const bool down = came < 8;
      const std::uint32_t in = offset(half, place[h], down ? 7 - came : came - 8, down, away[h]);
      const auto d = static_cast<std::int32_t>(in);
      const std::int32_t range = place[h].base + (down ? -1 - d : d);
      if constexpr (kReads) {
        if (range < 0 || range > limit_) throw Error(ErrorCode::Section, "a range beyond what the sensor can give");
        ranges[place[h].cell] = range;
      }
      settle(half, about, place[h], range, came);
      sizes[place[h].cell] = half.size1;
      ++half.next;
    }
  }

  // Finds everything that is known of the next return of a half.
  void look(const PredictiveHalf<Coder>& half, const RowSurroundings& about, std::uint32_t cell, Place& place) {
    const std::int32_t base = half.begun ? half.last[0] : about.above != nullptr ? about.above[cell] : first_;
    std::array<std::int32_t, 6> alike;  // for rows that are not there
    alike.fill(base);
    const std::int32_t* const up = about.above != nullptr ? about.above + cell - 1 : alike.data();
    const std::int32_t* const upper = about.upper != nullptr ? about.upper + cell - 1 : alike.data();
    const std::int32_t* const last = half.begun ? half.last.data() + 1 : alike.data();
    const std::uint32_t* const size = about.sizes + cell;
    const std::uint32_t mean =
        (5 * half.size1 + 3 * half.size2 + 3 * size[0] + size[-1] + 2 * size[1] + 2 * size[2]) / 16;
    const std::uint32_t scale = scale_class(mean);

    std::array<std::uint8_t, kAllFeatures> of;
    find_positions({last, up, upper, base, half.level >> (kDifferenceBits - 2)}, scale, of.data());
    const auto relative = [&](std::uint32_t size_of) {
      const std::int32_t c = static_cast<std::int32_t>(scale_class(size_of)) - static_cast<std::int32_t>(scale) + 7;
      return static_cast<std::uint8_t>(std::clamp(c, 0, 15));
    };
    const std::uint8_t *m = about.here + cell, *a = about.above_mask + cell, *b = about.below_mask + cell;
    of[kScale] = static_cast<std::uint8_t>(scale / 2);
    of[kMask] = static_cast<std::uint8_t>(m[1] | b[0] << 1 | a[0] << 2 | m[-1] << 3);
    of[kMeanSize] = relative(half.mean);
    of[kLastSize] = relative(half.size1);
    of[kUpSize] = relative(size[0]);
    of[kLastLeaf] = static_cast<std::uint8_t>(half.leaves >> 4);
    const std::uint32_t mask = static_cast<std::uint32_t>(m[-1] | m[-2] << 1 | m[1] << 2 | m[2] << 3 | b[0] << 4 |
                                                          b[-1] << 5 | b[1] << 6 | a[0] << 7 | a[1] << 8);
    place.cell = cell;
    place.scale = scale;
    place.base = base;
    const std::int32_t levelled = half.level >> kDifferenceBits;
    place.near = {up[1], up[2], last[0], upper[1], up[0], last[1], up[1] + levelled, up[3]};
    if constexpr (kExpects) {
      const std::int32_t* const seen = about.expected + cell;
      const std::uint8_t* const known = about.known + cell;
      const bool above = about.above != nullptr;
      find_expected_positions({seen - 1, above ? about.expected_above + cell - 1 : up, up, base,
                               half.bias >> (kDifferenceBits - 2)},
                              scale, of.data() + kSeenLeft);
      of[kSeenMask] = static_cast<std::uint8_t>(known[-1] | known[1] << 1 | known[0] << 2 | a[0] << 3);
      of[kSeenSize] = relative(half.miss);
      if (known[0] != 0) {
        std::copy_backward(place.near.begin(), place.near.end() - 1, place.near.end());
        place.near[0] = seen[0] + (half.bias >> kDifferenceBits);
      }
    }
    model_.template find<kExpects>(of, scale, half.leaves, mask, place.slots);
  }

  static std::uint32_t leaf_of(std::uint32_t scale, std::uint32_t away) {
    std::uint32_t leaf = 0;
    for (std::size_t l = 1; l < 8; ++l) leaf += away >= kLeafBegins[scale][l];
    return leaf;
  }

  static void learn(const Slots& slots, const std::array<Cells, 2>& p, const Walk& walked) {
    std::array<std::array<Cells, 2>, kPredictiveRates.size()> by;
    for (std::size_t v = 0; v < 2; ++v) {
      const Cells wanted = Cells::load(walked.wanted.data() + 8 * v), taken = Cells::load(walked.taken.data() + 8 * v);
#pragma GCC unroll 4
      for (std::size_t r = 0; r < by.size(); ++r) by[r][v] = moves(wanted, taken, p[v], kPredictiveRates[r]);
    }
    for (std::size_t r = 0; r + 1 < by.size(); ++r) by[r][0] = by[r][0] + Cells::load(kSeenOnce.data());
#pragma GCC unroll 16
    for (std::size_t i = 0; i < kUsed; ++i) {
      std::int16_t* const slot = slots[i];
      const std::int16_t count = slot[0];
      const std::array<Cells, 2>& move = by[kRateOfCount[static_cast<std::size_t>(count)]];
      (Cells::load(slot) + move[0]).store(slot);
      (Cells::load(slot + 8) + move[1]).store(slot + 8);
    }
  }

  // A decision whose log odds are the sum of two cells, which learn from it.
  std::uint32_t decide(PredictiveHalf<Coder>& half, std::int16_t& a, std::int16_t& b, std::int32_t offset,
                       std::uint32_t bit) {
    const std::int32_t sum = std::clamp(a + b + offset, -32768, 32767);
    const auto t = static_cast<std::uint32_t>(65534 - 2 * (sum < 0 ? -1 - sum : sum));  // as `probabilities`
    const std::uint32_t square = (t * t) >> 16;
    const auto rare = std::max(static_cast<std::int32_t>((square * t) >> 18), std::int32_t{kRarest});
    const std::int32_t p = sum < 0 ? rare : kOne - rare;
    if constexpr (kReads) {
      bit = half.coder.decode(half.interval, static_cast<std::uint32_t>(p));
    } else {
      half.coder.encode(half.interval, bit, static_cast<std::uint32_t>(p));
    }
    const std::int32_t by = (((bit != 0 ? kOne : 0) - p) * kOffsetRate + 0x8000) >> 16;
    a = static_cast<std::int16_t>(std::clamp(a + by, -32768, 32767));
    b = static_cast<std::int16_t>(std::clamp(b + by, -32768, 32767));
    return bit;
  }

  // Writes or reads how far away within its leaf, or beyond the last one, a return lies; gives how far away.
  std::uint32_t offset(PredictiveHalf<Coder>& half, const Place& place, std::uint32_t leaf, bool down,
                       std::uint32_t away) {
    std::uint32_t begin = kLeafBegins[place.scale][leaf];
    std::uint32_t left = leaf < 7 ? kLeafBits[place.scale][leaf] : kBeyondBits[place.scale];
    if (leaf < 7 && left == 0) return begin;
    OffsetCells& cells = model_.offsets;
    const std::int32_t turned = down ? -1 : 0;
    std::array<std::int32_t, kNeighbours> near;  // how far away they lie, negative on the other side
    for (std::size_t i = 0; i < kNeighbours; ++i) near[i] = (place.near[i] - place.base) ^ turned;
    const auto within = [&](std::uint32_t low, std::uint32_t high) {  // which neighbours are, a bit for each
      return neighbours_within(near, static_cast<std::int32_t>(low), static_cast<std::int32_t>(high));
    };
    if (leaf == 7) {
      for (std::uint32_t octave = 0;; ++octave) {
        if (octave >= kMaxOctaves || begin > static_cast<std::uint32_t>(limit_))
          throw Error(ErrorCode::Section, "a range beyond what the sensor can give");
        const std::uint32_t end = begin + (1u << left);
        const std::uint32_t here = within(begin, end), beyond = within(end, 1u << 30);
        const std::uint32_t who = (here & 3) | (beyond & 3) << 2 | (here & 12) << 2 | (beyond & 8) << 3;
        const std::uint32_t more = decide(half, cells.more[octave * 128 + who],
                                          cells.more_of_scale[place.scale * 32 + octave], 2730, away >= end);
        if (more == 0) break;
        begin = end;
        ++left;
      }
    }
    const std::uint32_t side = leaf == 7 ? 16 : 2 * leaf + down;
    for (std::uint32_t depth = 0; left > 0 && depth < OffsetCells::kDepth; ++depth) {
      --left;
      const std::uint32_t middle = begin + (1u << left), end = middle + (1u << left);
      // What the likeliest neighbour here says, if there is one: which half. The first is believed more than others.
      const std::uint32_t low = within(begin, middle), high = within(middle, end), any = low | high;
      const std::uint32_t likeliest = any & (0u - any);
      const std::uint32_t says = any == 0 ? 0 : 1 + ((high & likeliest) != 0) + (likeliest == 1 ? 0 : 2);
      std::int16_t& a = cells.near[(says * 4 + depth) * 32 + side];
      std::int16_t& b = cells.leaf[(place.scale * 8 + leaf) * 4 + depth];
      if (decide(half, a, b, 0, away >= middle) != 0) begin = middle;
    }
    if (left > 0) {
      if (left > 16) throw Error(ErrorCode::Section, "a range beyond what the sensor can give");
      if constexpr (kReads) {
        begin += half.coder.decode_plain(half.interval, left);
      } else {
        half.coder.encode_plain(half.interval, away - begin, left);
      }
    }
    return kReads ? begin : away;
  }

  // Takes note of a return.
  void settle(PredictiveHalf<Coder>& half, const RowSurroundings& about, const Place& place, std::int32_t range,
              std::uint32_t leaf) {
    const std::uint32_t size = difference(range - place.base);
    half.size2 = (half.size2 + half.size1) / 2;
    half.size1 = size;
    half.mean += (static_cast<std::int32_t>(size) - static_cast<std::int32_t>(half.mean)) / 8;
    half.leaves = half.leaves >> 4 | leaf << 4;
    const std::int32_t up = about.above == nullptr ? place.base : about.above[place.cell];
    const std::int32_t level = (range - up) * (1 << kDifferenceBits);
    const std::int32_t apart = level - half.level;
    const auto far = static_cast<std::int32_t>(kPositionLimits[place.scale][5]);  // 3.6 times the scale, in quarters
    if (!half.begun || std::abs(apart) > 4 * far) {
      half.level = level;
    } else {
      half.level += apart * 11 / 32;
    }
    if constexpr (kExpects) {
      if (about.known[place.cell] != 0) {
        const std::int32_t off = (range - about.expected[place.cell]) * (1 << kDifferenceBits), by = off - half.bias;
        half.miss += (static_cast<std::int32_t>(difference(by >> kDifferenceBits)) - static_cast<std::int32_t>(half.miss)) / 4;
        if (std::abs(by) <= 4 * far) half.bias += by / 4;
      }
    }
    if (half.begun) {
      half.last = {range, half.last[0], half.last[1], half.last[2], half.last[3]};
    } else {
      half.last.fill(range);
    }
    half.begun = true;
  }

  PredictiveModel& model_;
  std::uint32_t start_;
  std::int32_t first_, limit_;
  Halves& halves_;
};

}  // namespace lidarcodec
