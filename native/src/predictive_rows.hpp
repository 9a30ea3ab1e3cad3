// Rows of ranges: what is coded when, and how models learn from it.
#pragma once
#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>
#include <type_traits>

#include "cells.hpp"
#include "error.hpp"
#include "predictive_forms.hpp"
#include "predictive_model.hpp"
#include "range_decisions.hpp"
#include "riddle_inputs.hpp"
#include "riddle_net.hpp"
#include "riddle_samples.hpp"
#include "row_state.hpp"
#include "wide_coder.hpp"

namespace lidarcodec {

// What kLearned rows are coded with: a network, and where samples go; one of them may be missing.
struct Teaching {
  const RiddleNet* net = nullptr;
  RiddleSamples* samples = nullptr;
};

// Codes rows of ranges; `Coder` is WideEncoder or WideDecoder, `Forms` those of predictive_forms.hpp for the processor.
// The two halves of a row take turns, a return each.
// kLearned: a network says what is likely to begin with, and returns beyond the last leaf have a tree of their own.
template <class Coder, class Forms, bool kExpects, bool kLearned>
class PredictiveRows : RangeDecisions<Coder> {
  using Decisions = RangeDecisions<Coder>;
  using Decisions::beyond_leaf, Decisions::decide, Decisions::first_offsets, Decisions::leaf_of, Decisions::limit_, Decisions::model_;

 public:
  using Decisions::kReads;
  using Halves = std::array<PredictiveHalf<Coder>, 2>;

  // step: native range steps in a cell; limit: largest range, in cells; teaching: where kLearned.
  PredictiveRows(PredictiveModel& model, const Teaching& teaching, std::uint32_t step, std::int32_t limit, Halves& halves)
      : Decisions(model, limit), teaching_(teaching), step_(step), start_(480 / step + 5),
        first_(static_cast<std::int32_t>(2500 / step)), halves_(halves) {}

  // Writes or reads the ranges of the returns of a row, its halves in turns. Raises Section or Truncated.
  void code(const RowWork& row) {
    const std::size_t n = row.count, half = (n + 1) / 2;
    for (std::size_t h = 0; h < 2; ++h) {
      const std::size_t first = h == 0 ? 0 : half;
      if (first < n) halves_[h].begin(first, half, base_of(row, first), RowState::at_start(start_));
      if constexpr (!kReads) halves_[h].coder.make_room(half * kMostDecisions);
    }
    Forms::run([&] {
      for (std::size_t i = half; i < n; ++i) step<2>(row, row);
      if (n % 2 != 0) step_one(row);
    });
  }

  // The same of two rows in turns, each of which goes on from where it ended, and says where it ends.
  void code(const RowWork& a, RowEnd& end_a, const RowWork& b, RowEnd& end_b) {
    for (std::size_t h = 0; h < 2; ++h) {
      const RowWork& row = h == 0 ? a : b;
      if (row.count > 0) halves_[h].resume(row.count, base_of(row, 0), h == 0 ? end_a : end_b);
      if constexpr (!kReads) halves_[h].coder.make_room(row.count * kMostDecisions);
    }
    const std::size_t both = std::min(a.count, b.count);
    Forms::run([&] {
      for (std::size_t i = 0; i < both; ++i) step<2>(a, b);
      for (std::size_t i = both; i < a.count; ++i) step_one(a);
      for (std::size_t i = both; i < b.count; ++i) step_one<1>(b);
    });
    if (a.count > 0) end_a = halves_[0].end();
    if (b.count > 0) end_b = halves_[1].end();
  }

  std::uint32_t start() const { return start_; }  // difference to begin with
  std::int32_t first() const { return first_; }   // range to begin with

 private:
  static constexpr std::size_t kMostDecisions = 8 + OffsetCells::kDepth + kMaxOctaves + 4;

  static constexpr std::size_t kAlike = 16, kAlikeLeft = 4;  // ranges of a row that is not there; those to the left

  struct Learned {
    NetValues values;
  };
  struct Nothing {};

  // A return about to be coded.
  struct Place {
    std::uint32_t cell, scale;
    std::int32_t base;               // where differences are counted from
    const std::int32_t *up, *upper;  // the rows above, from the cell to the left of this one
    Slots slots;
    Chances chances;
    [[no_unique_address]] std::conditional_t<kLearned, Learned, Nothing> net;
    std::array<std::int32_t, kAlike> alike;  // for rows that are not there
  };

  // Where the first difference of a row, or of a half of one, is counted from.
  std::int32_t base_of(const RowWork& row, std::size_t first) const {
    return row.about.above != nullptr ? row.about.above[row.cells[first]] : first_;
  }

  // The last returns, where a half has more of them. Not inlined, nor is what few returns need: all of it, in all forms,
  // took minutes to compile.
  template <std::size_t First = 0>
  [[gnu::noinline]] void step_one(const RowWork& row) {
    step<1, First>(row, row);
  }

  // Codes a return of each of N halves, from half `First` on; `rows` are theirs.
  template <std::size_t N, std::size_t First = 0>
  void step(const RowWork& row_a, const RowWork& row_b) {
    const std::array<const RowWork*, 2> rows = {&row_a, &row_b};
    PredictiveHalf<Coder>* const halves = halves_.data() + First;
    std::array<Place, N> place;
    std::array<WideInterval, N> interval;
    std::array<std::uint32_t, N> node;
    std::array<std::uint32_t, N> leaf{}, away{};
    for (std::size_t h = 0; h < N; ++h) {
      look(halves[h], rows[h]->about, rows[h]->cells[halves[h].next], place[h]);
      interval[h] = halves[h].interval;
      node[h] = 1;
      if constexpr (!kReads) {
        const std::int32_t d = rows[h]->ranges[place[h].cell] - place[h].base;
        away[h] = static_cast<std::uint32_t>(d < 0 ? -1 - d : d);
        const std::uint32_t l = leaf_of(place[h].scale, away[h]);
        leaf[h] = d < 0 ? 7 - l : 8 + l;
      }
    }
    if constexpr (kLearned) {
      if (teaching_.net != nullptr) {
        if constexpr (N == 2) {
          teaching_.net->run(place[0].net.values, place[1].net.values);
        } else {
          teaching_.net->run(place[0].net.values);
        }
      }
      for (Place& p : place)
        Forms::template add_up<kExpects, true>(model_.cells(), p.slots, p.net.values.out.data(), p.chances);
    }
#pragma GCC unroll 4
    for (int level = 3; level >= 0; --level) {
#pragma GCC unroll 2
      for (std::size_t h = 0; h < N; ++h) {
        const auto probability = static_cast<std::uint32_t>(place[h].chances.of[node[h]]);
        std::uint32_t bit;
        if constexpr (kReads) {
          bit = halves[h].coder.decode(interval[h], probability);
        } else {
          bit = leaf[h] >> level & 1u;
          halves[h].coder.encode(interval[h], bit, probability);
        }
        node[h] = 2 * node[h] + bit;
      }
    }
    for (std::size_t h = 0; h < N; ++h) {
      Forms::template learn<kExpects, kLearned>(model_.cells(), place[h].slots, place[h].chances, kWalks[node[h]]);
      PredictiveHalf<Coder>& half = halves[h];
      const std::uint32_t came = node[h] - 16;
      const bool down = came < 8;
      const std::uint32_t in = offset(half, interval[h], rows[h]->about, place[h], down ? 7 - came : came - 8, down, away[h]);
      half.interval = interval[h];
      if constexpr (kLearned && !kReads) {
        if (teaching_.samples != nullptr && teaching_.samples->next_is_taken())
          teaching_.samples->take(place[h].net.values, came, first_offsets(place[h].scale, came, in), place[h].chances.of.data(), of_cells_);
      }
      const auto d = static_cast<std::int32_t>(in);
      const std::int32_t range = place[h].base + (down ? -1 - d : d);
      if constexpr (kReads) {
        if (range < 0 || range > limit_) throw Error(ErrorCode::Section, "a range beyond what the sensor can give");
        rows[h]->ranges[place[h].cell] = range;
      }
      settle(half, rows[h]->about, place[h], range, came);
      rows[h]->sizes[place[h].cell] = half.size1;
      ++half.next;
    }
  }

  // Finds everything that is known of the next return of a half.
  void look(const PredictiveHalf<Coder>& half, const RowSurroundings& about, std::uint32_t cell, Place& place) {
    const std::int32_t base = half.last[0];
    place.cell = cell;
    place.base = base;
    if (about.upper == nullptr) [[unlikely]] place.alike.fill(base);
    const std::int32_t* const alike = place.alike.data() + kAlikeLeft - 1;
    place.up = about.above != nullptr ? about.above + cell - 1 : alike;
    place.upper = about.upper != nullptr ? about.upper + cell - 1 : alike;
    const std::uint32_t mean = (5 * half.size1 + 3 * half.size2 + about.sizes_around[cell]) / 16;
    place.scale = scale_class(mean);
    Known known;
    known.around = {half.last + 1, place.up, place.upper, base, half.level >> (kDifferenceBits - 2)};
    known.scale = place.scale;
    known.leaves = half.leaves;
    known.returns = about.returns[cell];
    known.mean_size = half.mean;
    known.last_size = half.size1;
    known.up_size = about.sizes[cell];
    if constexpr (kExpects) {
      known.expected = {about.expected + cell - 1, about.above != nullptr ? about.expected_above + cell - 1 : place.up,
                        place.up, base, half.bias >> (kDifferenceBits - 2)};
      known.seen_size = half.miss;
    }
    Forms::template find<kExpects>(known, place.slots);
    if constexpr (kLearned) {
      look_for_net(half, about, place);
    } else {
      Forms::template add_up<kExpects, false>(model_.cells(), place.slots, nullptr, place.chances);
    }
  }

  // What the network is told of a return.
  void look_for_net(const PredictiveHalf<Coder>& half, const RowSurroundings& about, Place& place) {
    const std::uint32_t cell = place.cell;
    Surroundings s{};
    s.last = half.last;
    s.up = place.up + 1;
    s.upper = place.upper + 1;
    s.sizes = about.sizes + cell;
    s.here = about.mask + cell;
    s.above = about.above_mask + cell;
    s.below = about.below_mask + cell;
    if constexpr (kExpects) {
      s.seen = about.expected + cell;
      s.seen_above = about.above != nullptr ? about.expected_above + cell : s.up;
      s.seen_below = about.expected_below != nullptr ? about.expected_below + cell : s.seen;
      s.known = about.known + cell;
    }
    s.level = half.level;
    s.bias = half.bias;
    s.size1 = half.size1;
    s.size2 = half.size2;
    s.mean = half.mean;
    s.miss = half.miss;
    s.scale = place.scale;
    s.leaves = half.leaves;
    s.row = about.row;
    s.gap = half.begun && cell > half.last_cell ? cell - half.last_cell : 1u;
    s.step = step_;
    s.begun = half.begun;
    find_inputs<kExpects>(s, place.net.values.in.data());
  }

  // Ranges around, the likeliest first, as they lie from the base.
  NearRanges near_ranges(const PredictiveHalf<Coder>& half, const RowSurroundings& about, const Place& place, bool down) {
    const std::int32_t *up = place.up, levelled = up[1] + (half.level >> kDifferenceBits);
    if constexpr (kExpects) {
      if (expects(about, place.cell)) {
        const std::int32_t seen = about.expected[place.cell] + (half.bias >> kDifferenceBits);
        return {{seen, up[1], up[2], half.last[1], place.upper[1], up[0], half.last[2], levelled}, place.base, down};
      }
    }
    return {{up[1], up[2], half.last[1], place.upper[1], up[0], half.last[2], levelled, up[3]}, place.base, down};
  }

  static bool expects(const RowSurroundings& about, std::uint32_t cell) { return (about.returns[cell] >> 11 & 1u) != 0; }

  // Writes or reads how far away within its leaf, or beyond the last one, a return lies; gives how far away.
  std::uint32_t offset(PredictiveHalf<Coder>& half, WideInterval& interval, const RowSurroundings& about,
                       const Place& place, std::uint32_t leaf, bool down, std::uint32_t away) {
    std::uint32_t begin = kLeafBegins[place.scale][leaf];
    std::uint32_t left = leaf < 7 ? kLeafBits[place.scale][leaf] : kBeyondBits[place.scale];
    if (leaf < 7 && left == 0) return begin;
    if constexpr (kLearned) {
      if (leaf == 7) {
        const auto least = static_cast<std::int32_t>(begin);
        return beyond_leaf(half.coder, interval, {anchors(half, about, place), place.base, down, least, place.scale}, begin, away);
      }
    }
    OffsetCells& cells = model_.offsets;
    const NearRanges near = near_ranges(half, about, place, down);
    std::uint32_t end = begin + (1u << left);
    std::uint32_t from_begin = near.from(begin), from_end = near.from(end);  // which are not nearer than those
    if (leaf == 7) {
      for (std::uint32_t octave = 0;; ++octave) {
        if (octave >= kMaxOctaves || begin > static_cast<std::uint32_t>(limit_))
          throw Error(ErrorCode::Section, "a range beyond what the sensor can give");
        const std::uint32_t here = from_begin & ~from_end, beyond = from_end;
        const std::uint32_t who = (here & 3) | (beyond & 3) << 2 | (here & 12) << 2 | (beyond & 8) << 3;
        const std::uint32_t more = decide(half.coder, interval, cells.more[octave * 128 + who],
                                          cells.more_of_scale[place.scale * 32 + octave], 2730, away >= end);
        if (more == 0) break;
        begin = end;
        end = begin + (1u << ++left);
        from_begin = from_end;
        from_end = near.from(end);
      }
    }
    const std::uint32_t side = leaf == 7 ? 16 : 2 * leaf + down;
    for (std::uint32_t depth = 0; left > 0 && depth < OffsetCells::kDepth; ++depth) {
      --left;
      const std::uint32_t middle = begin + (1u << left), from_middle = near.from(middle);
      // What the likeliest neighbour here says, if there is one: which half. The first is believed more than others.
      const std::uint32_t any = from_begin & ~from_end, likeliest = any & (0u - any);
      const std::uint32_t says = any == 0 ? 0 : 1 + ((from_middle & likeliest) != 0) + (likeliest == 1 ? 0 : 2);
      std::int16_t& a = cells.near[(says * 4 + depth) * 32 + side];
      std::int16_t& b = cells.leaf[(place.scale * 8 + leaf) * 4 + depth];
      if constexpr (kLearned && !kReads) of_cells_[depth] = a + b;
      if (decide(half.coder, interval, a, b, said(place, leaf, down, depth), away >= middle, kLearned ? kLearnedOffsetRate : kOffsetRate) != 0) {
        begin = middle;
        from_begin = from_middle;
      } else {
        from_end = from_middle;
      }
    }
    if (left > 0) {
      if (left > 16) throw Error(ErrorCode::Section, "a range beyond what the sensor can give");
      if constexpr (kReads) {
        begin += half.coder.decode_plain(interval, left);
      } else {
        half.coder.encode_plain(interval, away - begin, left);
      }
    }
    return kReads ? begin : away;
  }

  // Log odds of an offset bit: the network's of the first one, and half as much for each further one, as where the
  // logarithm of the density is a straight line.
  static std::int32_t said(const Place& place, std::uint32_t leaf, bool down, std::uint32_t depth) {
    if constexpr (kLearned) {
      if (leaf < 7) return place.net.values.out[16 + (down ? 7 - leaf : 8 + leaf)] >> depth;
    }
    return 0;
  }

  std::int32_t possible(std::int32_t range) const { return std::clamp(range, 0, limit_); }

  // Ranges around that a return beyond the last leaf may belong to, the likeliest first.
  std::array<std::int32_t, kAnchors> anchors(const PredictiveHalf<Coder>& half, const RowSurroundings& about,
                                             const Place& place) {
    const std::int32_t *up = place.up, *upper = place.upper, *last = half.last;
    if constexpr (kExpects) {
      const std::int32_t* const seen = about.expected + place.cell;
      const std::int32_t below = about.expected_below != nullptr ? about.expected_below[place.cell] : seen[0];
      return {seen[1], seen[0], below, seen[2], up[1], up[2], possible(seen[0] + (half.bias >> kDifferenceBits)), seen[-1], upper[1], last[1]};
    }
    return {up[1], up[2], up[3], upper[1], possible(up[1] + (half.level >> kDifferenceBits)), up[0], last[1], upper[2], last[2], upper[3]};
  }

  // Takes note of a return.
  void settle(PredictiveHalf<Coder>& half, const RowSurroundings& about, const Place& place, std::int32_t range,
              std::uint32_t leaf) {
    const std::uint32_t size = difference(range - place.base);
    half.size2 = (half.size2 + half.size1) / 2;
    half.size1 = size;
    half.mean += (static_cast<std::int32_t>(size) - static_cast<std::int32_t>(half.mean)) / 8;
    half.leaves = half.leaves >> 4 | leaf << 4;
    const std::int32_t level = (range - place.up[1]) * (1 << kDifferenceBits);
    const std::int32_t apart = level - half.level;
    const auto far = static_cast<std::int32_t>(kPositionLimits[place.scale][5]);  // 3.6 times the scale, in quarters
    if (!half.begun || std::abs(apart) > 4 * far) {
      half.level = level;
    } else {
      half.level += apart * 11 / 32;
    }
    if constexpr (kExpects) {
      if (expects(about, place.cell)) {
        const std::int32_t off = (range - about.expected[place.cell]) * (1 << kDifferenceBits), by = off - half.bias;
        half.miss += (static_cast<std::int32_t>(difference(by >> kDifferenceBits)) - static_cast<std::int32_t>(half.miss)) / 4;
        if (std::abs(by) <= 4 * far) half.bias += by / 4;
      }
    }
    half.last_cell = place.cell;
    half.take(range);
  }

  Teaching teaching_;
  std::uint32_t step_;
  std::uint32_t start_;
  std::int32_t first_;
  Halves& halves_;
  std::array<std::int32_t, RiddleSamples::kOffsets> of_cells_{};  // what contexts said of a return's offset bits
};

}  // namespace lidarcodec
