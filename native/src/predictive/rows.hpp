// Rows of ranges: what is coded when, and how models learn from it.
#pragma once
#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>
#include <type_traits>

#include "bits/cells.hpp"
#include "base/error.hpp"
#include "predictive/free_cells.hpp"
#include "predictive/forms.hpp"
#include "predictive/model.hpp"
#include "predictive/range_decisions.hpp"
#include "predictive/net_inputs.hpp"
#include "network/net.hpp"
#include "network/samples.hpp"
#include "predictive/row_state.hpp"
#include "bits/wide_coder.hpp"

namespace lidarcodec {

// What kLearned rows are coded with: a network, and where samples go; one of them may be missing.
struct Teaching {
  const RiddleNet* net = nullptr;
  RiddleSamples* samples = nullptr;
};

// Codes rows of ranges; `Coder` is WideEncoder or WideDecoder, `Forms` those of predictive/forms.hpp for the processor.
// The four quarters of a row, or two rows of a slab, take turns, a return each: what one waits for, another fills, and the
// weights of a network are fetched once for all of them.
// kLearned: a network says what is likely to begin with, and returns beyond the last leaf have a tree of their own.
template <class Coder, class Forms, bool kExpects, bool kLearned>
class PredictiveRows : RangeDecisions<Coder> {
  using Decisions = RangeDecisions<Coder>;
  using Decisions::beyond_leaf, Decisions::decide, Decisions::first_offsets, Decisions::limit_;
  using Decisions::model_, Decisions::plain;

 public:
  using Decisions::kReads;
  using Parts = PredictiveParts<Coder>;

  // cells: those of ranges; limit: the largest one; teaching: where kLearned.
  // quick: not where kLearned.
  PredictiveRows(PredictiveModel& model, const Teaching& teaching, const RangeCells& cells, std::int32_t limit, bool quick, Parts& parts)
      : Decisions(model, limit), teaching_(teaching), step_(cells.step), start_(480 / step_ + 5),
        first_(static_cast<std::int32_t>(2500 / step_ * 16)), free_(cells.free), half_(cells.free ? 8 : 0),
        lowest_(-2 * half_), highest_(16 * limit + 2 * half_), free_cells_(step_), quick_(!kLearned && quick),
        parts_(parts) {
    model.begin(quick_);
  }

  // Writes or reads the ranges of the returns of a row, its quarters in turns. Raises Section or Truncated.
  void code(const RowWork& row) {
    const std::size_t n = row.count, quarter = (n + kMostParts - 1) / kMostParts;
    std::array<std::size_t, kMostParts> counts;
    for (std::size_t p = 0; p < kMostParts; ++p) {
      const std::size_t first = std::min(n, p * quarter);
      counts[p] = std::min(quarter, n - first);
      if (counts[p] > 0) parts_[p].begin(first, counts[p], base_of(row, first), RowState::at_start(start_));
      if constexpr (!kReads) parts_[p].coder.make_room(counts[p] * kMostDecisions);
    }
    code_in_turns<kMostParts>({&row, &row, &row, &row}, counts);
  }

  // The same of two rows in turns, each of which goes on from where it ended, and says where it ends.
  void code(const RowWork& a, RowEnd& end_a, const RowWork& b, RowEnd& end_b) {
    const std::array<RowEnd*, 2> ends = {&end_a, &end_b};
    const std::array<const RowWork*, 2> rows = {&a, &b};
    for (std::size_t p = 0; p < 2; ++p) {
      if (rows[p]->count > 0) parts_[p].resume(rows[p]->count, base_of(*rows[p], 0), *ends[p]);
      if constexpr (!kReads) parts_[p].coder.make_room(rows[p]->count * kMostDecisions);
    }
    code_in_turns<2>(rows, {a.count, b.count});
    for (std::size_t p = 0; p < 2; ++p)
      if (rows[p]->count > 0) *ends[p] = parts_[p].end();
  }

  std::uint32_t start() const { return start_; }  // difference to begin with
  std::int32_t first() const { return first_; }   // range to begin with, sixteenths

 private:
  static constexpr std::size_t kMostDecisions = 8 + OffsetCells::kDepth + kMaxOctaves + 4;

  static constexpr auto &kAll = all_contexts<kExpects>(), &kQuick = quick_contexts<kExpects>();

  static constexpr std::size_t kAlike = 16, kAlikeLeft = 4;  // ranges of a row that is not there; those to the left

  struct Learned {
    NetValues values;
    alignas(32) std::array<std::int16_t, kSlotCells> said;  // log odds of the contexts
  };
  struct Nothing {};

  // A return about to be coded.
  struct Place {
    std::uint32_t cell, scale;
    std::int32_t base;               // where differences are counted from, sixteenths of a cell
    const std::int32_t *up, *upper;  // the rows above, from the cell to the left of this one
    Slots slots;
    Chances chances;
    [[no_unique_address]] std::conditional_t<kLearned, Learned, Nothing> net;
    std::array<std::int32_t, kAlike> alike;  // for rows that are not there
  };

  // Where the first difference of a row, or of a part of one, is counted from.
  std::int32_t base_of(const RowWork& row, std::size_t first) const {
    return row.about.above != nullptr ? row.about.above[row.cells[first]] : first_;
  }

  // So many returns of N parts: one of each at a time as long as all have some, then one by one.
  template <std::size_t N>
  void code_in_turns(const std::array<const RowWork*, N>& rows, const std::array<std::size_t, N>& counts) {
    const std::size_t all = *std::min_element(counts.begin(), counts.end()), most = *std::max_element(counts.begin(), counts.end());
    Forms::run([&] {
      for (std::size_t i = 0; i < all; ++i) step<N>(rows);
      for (std::size_t i = all; i < most; ++i)
        for (std::size_t p = 0; p < N; ++p)
          if (i < counts[p]) step_one(*rows[p], p);
    });
  }

  // Not inlined, nor is what few returns need: all of it, in all forms, took minutes to compile.
  [[gnu::noinline]] void step_one(const RowWork& row, std::size_t part) { step<1>({&row}, part); }

  // Codes a return of each of N parts, from part `first` on; `rows` are theirs.
  template <std::size_t N>
  void step(const std::array<const RowWork*, N>& rows, std::size_t first = 0) {
    PredictivePart<Coder>* const parts = parts_.data() + first;
    std::array<Place, N> place;
    std::array<WideInterval, N> interval;
    std::array<std::uint32_t, N> node;
    std::array<std::uint32_t, N> leaf{}, away{};
    for (std::size_t p = 0; p < N; ++p) {
      look(parts[p], rows[p]->about, rows[p]->cells[parts[p].next], place[p]);
      interval[p] = parts[p].interval;
      node[p] = 1;
      if constexpr (!kReads)
        if (!free_) aim(place[p], (rows[p]->ranges[place[p].cell] - place[p].base) / 16, leaf[p], away[p]);
    }
    if constexpr (kLearned) {
      if (teaching_.net != nullptr) {
        std::array<NetValues*, N> values;
        for (std::size_t p = 0; p < N; ++p) values[p] = &place[p].net.values;
        teaching_.net->run(values);
      } else {
        for (Place& at : place) at.net.values.out.fill(0);
      }
      for (Place& at : place)
        Forms::template weigh<kAll>(model_.cells(), at.slots, at.net.values.out.data(), model_.balance[at.scale], at.net.said.data(), at.chances);
    }
    if constexpr (!kReads) {
      if (free_) {
        const FreeChoice choice(free_cells_, step_);
        for (std::size_t p = 0; p < N; ++p)
          aim(place[p], choice.cell(*rows[p], parts[p].next, parts[p].stop, place[p].base, leaves(), place[p].scale, place[p].chances), leaf[p], away[p]);
      }
    }
#pragma GCC unroll 4
    for (int level = 3; level >= 0; --level) {
#pragma GCC unroll 4
      for (std::size_t p = 0; p < N; ++p) {
        const auto probability = static_cast<std::uint32_t>(place[p].chances.of[node[p]]);
        std::uint32_t bit;
        if constexpr (kReads) {
          bit = parts[p].coder.decode(interval[p], probability);
        } else {
          bit = leaf[p] >> level & 1u;
          parts[p].coder.encode(interval[p], bit, probability);
        }
        node[p] = 2 * node[p] + bit;
      }
    }
    std::array<std::int32_t, N> of_leaf{};
    if constexpr (kLearned) {
      if (teaching_.net != nullptr)
        for (std::size_t p = 0; p < N; ++p) of_leaf[p] = teaching_.net->template leaf_odds<Forms>(place[p].net.values, node[p] - 16);
    }
    for (std::size_t p = 0; p < N; ++p) {
      learn(place[p], kWalks[node[p]]);
      if constexpr (kLearned)
        Forms::learn_weights(model_.balance[place[p].scale], place[p].net.values.out.data(), place[p].net.said.data(), place[p].chances, kWalks[node[p]]);
      PredictivePart<Coder>& part = parts[p];
      const std::uint32_t came = node[p] - 16;
      const bool down = came < 8;
      const std::uint32_t in = offset(part, interval[p], rows[p]->about, place[p], down ? 7 - came : came - 8, down, of_leaf[p], away[p]);
      part.interval = interval[p];
      if constexpr (kLearned && !kReads) {
        if (teaching_.samples != nullptr && teaching_.samples->next_is_taken())
          teaching_.samples->take(place[p].net.values, came, first_offsets(place[p].scale, came, in), place[p].chances.of.data(), of_cells_);
      }
      const auto d = static_cast<std::int32_t>(in);
      const std::int32_t number = down ? -1 - d : d, whole = place[p].base + 16 * number;
      const std::int32_t range = free_ ? free_cells_.middle(place[p].base, number) : whole;
      if constexpr (kReads) {
        if (range < lowest_ || range > highest_) throw Error(ErrorCode::Section, "a range beyond what the sensor can give");
      }
      rows[p]->ranges[place[p].cell] = range;
      settle(part, rows[p]->about, place[p], range, came);
      rows[p]->sizes[place[p].cell] = part.size1;
      ++part.next;
    }
  }

  // Where a cell lies, in a leaf and away.
  void aim(const Place& place, std::int32_t number, std::uint32_t& leaf, std::uint32_t& away) const {
    away = static_cast<std::uint32_t>(number < 0 ? -1 - number : number);
    const std::uint32_t l = leaves().of(place.scale, away);
    leaf = number < 0 ? 7 - l : 8 + l;
  }

  // Where free cells are counted from.
  static std::int32_t free_base(const PredictivePart<Coder>& part, const RowSurroundings& about, const Place& place) {
    const std::int32_t last = part.last[0];
    if constexpr (kExpects) {
      if (expects(about, place.cell))
        return FreeCells::base(last, place.up[1] + part.level, about.expected[place.cell] + part.bias);
    }
    return last;
  }

  // Finds everything that is known of the next return of a part.
  void look(const PredictivePart<Coder>& part, const RowSurroundings& about, std::uint32_t cell, Place& place) {
    place.cell = cell;
    if (about.upper == nullptr) [[unlikely]] place.alike.fill(part.last[0]);
    const std::int32_t* const alike = place.alike.data() + kAlikeLeft - 1;
    place.up = about.above != nullptr ? about.above + cell - 1 : alike;
    place.upper = about.upper != nullptr ? about.upper + cell - 1 : alike;
    const std::int32_t base = place.base = free_ ? free_base(part, about, place) : part.last[0];
    const std::uint32_t mean = (5 * part.size1 + 3 * part.size2 + about.sizes_around[cell]) / 16;
    place.scale = scale_class(mean);
    Known known;
    known.around = {part.last + 1, place.up, place.upper, base, part.level >> (kDifferenceBits - 2)};
    known.scale = place.scale;
    known.leaves = part.leaves;
    known.firing = about.first_firing + about.firings[about.columns[cell]];
    known.returns = about.returns[cell];
    known.mean_size = part.mean;
    known.last_size = part.size1;
    known.up_size = about.sizes[cell];
    if constexpr (kExpects) {
      known.expected = {about.expected + cell - 1, about.above != nullptr ? about.expected_above + cell - 1 : place.up,
                        place.up, base, part.bias >> (kDifferenceBits - 2)};
      known.seen_size = part.miss;
    }
    Forms::template find<kExpects>(known, place.slots);
    if constexpr (kLearned) {
      look_for_net(part, about, place);
    } else {
      add_up(place);
    }
  }

  const Leaves& leaves() const {
    if constexpr (kLearned) return kLeaves;
    return quick_ ? kQuickLeaves : kLeaves;
  }

  // Of the contexts that this kind goes with.
  void add_up(Place& place) {
    if (!quick_) [[unlikely]] return add_up_all(place);
    Forms::template add_up<kQuick>(model_.cells(), place.slots, place.chances);
  }
  void learn(const Place& place, const Walk& walked) {
    if constexpr (kLearned) {
      Forms::template learn<kAll, true>(model_.cells(), place.slots, place.chances, walked);
    } else {
      if (!quick_) [[unlikely]] return learn_all(place, walked);
      Forms::template learn<kQuick, false>(model_.cells(), place.slots, place.chances, walked);
    }
  }
  [[gnu::noinline]] void add_up_all(Place& place) { Forms::template add_up<kAll>(model_.cells(), place.slots, place.chances); }
  [[gnu::noinline]] void learn_all(const Place& place, const Walk& walked) {
    Forms::template learn<kAll, false>(model_.cells(), place.slots, place.chances, walked);
  }

  // What the network is told of a return.
  void look_for_net(const PredictivePart<Coder>& part, const RowSurroundings& about, Place& place) {
    const std::uint32_t cell = place.cell;
    Surroundings s{};
    s.base = place.base;
    s.last = part.last;
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
    s.level = part.level;
    s.bias = part.bias;
    s.size1 = part.size1;
    s.size2 = part.size2;
    s.mean = part.mean;
    s.miss = part.miss;
    s.scale = place.scale;
    s.leaves = part.leaves;
    s.row = about.row;
    s.gap = part.begun && cell > part.last_cell ? cell - part.last_cell : 1u;
    s.step = step_;
    s.begun = part.begun;
    Forms::template inputs<kExpects>(s, place.net.values.in.data());
  }

  // Ranges around, the likeliest first, as they lie from the base.
  NearRanges near_ranges(const PredictivePart<Coder>& part, const RowSurroundings& about, const Place& place, bool down) {
    const std::int32_t *up = place.up, levelled = up[1] + part.level, origin = place.base - half_;
    if constexpr (kExpects) {
      if (expects(about, place.cell)) {
        const std::int32_t seen = about.expected[place.cell] + part.bias;
        return Forms::near({seen, up[1], up[2], part.last[1], place.upper[1], up[0], part.last[2], levelled}, origin, down);
      }
    }
    return Forms::near({up[1], up[2], part.last[1], place.upper[1], up[0], part.last[2], levelled, up[3]}, origin, down);
  }

  static bool expects(const RowSurroundings& about, std::uint32_t cell) { return (about.returns[cell] >> 11 & 1u) != 0; }

  // Writes or reads how far away within its leaf, or beyond the last one, a return lies; gives how far away. said: the network's
  // log odds of the first offset bit; half as much goes for each further one, as where the logarithm of the density is a
  // straight line.
  std::uint32_t offset(PredictivePart<Coder>& part, WideInterval& interval, const RowSurroundings& about,
                       const Place& place, std::uint32_t leaf, bool down, std::int32_t said, std::uint32_t away) {
    std::uint32_t begin = leaves().begins[place.scale][leaf], left = leaves().bits[place.scale][leaf];
    if (leaf < 7 && left == 0) return begin;
    if constexpr (kLearned) {
      if (leaf == 7) {
        const auto least = static_cast<std::int32_t>(begin);
        return beyond_leaf(part.coder, interval, {anchors(part, about, place), place.base - half_, down, least, place.scale}, begin, away);
      }
    }
    if constexpr (!kLearned) {
      if (quick_ && leaf < 7) return begin + plain(part.coder, interval, left, away - begin);
    }
    OffsetCells& cells = model_.offsets;
    const NearRanges near = near_ranges(part, about, place, down);
    std::uint32_t end = begin + (1u << left);
    std::uint32_t from_begin = Forms::from(near, begin), from_end = Forms::from(near, end);  // which are not nearer than those
    if (leaf == 7) {
      for (std::uint32_t octave = 0;; ++octave) {
        if (octave >= kMaxOctaves || this->is_too_far(begin))
          throw Error(ErrorCode::Section, "a range beyond what the sensor can give");
        const std::uint32_t here = from_begin & ~from_end, beyond = from_end;
        const std::uint32_t who = (here & 3) | (beyond & 3) << 2 | (here & 12) << 2 | (beyond & 8) << 3;
        const std::uint32_t more = decide(part.coder, interval, cells.more[octave * 128 + who],
                                          cells.more_of_scale[place.scale * 32 + octave], 2730, away >= end);
        if (more == 0) break;
        begin = end;
        end = begin + (1u << ++left);
        from_begin = from_end;
        from_end = Forms::from(near, end);
      }
    }
    const std::uint32_t side = leaf == 7 ? 16 : 2 * leaf + down;
    for (std::uint32_t depth = 0; left > 0 && depth < kDepths[leaf]; ++depth) {
      --left;
      const std::uint32_t middle = begin + (1u << left), from_middle = Forms::from(near, middle);
      // What the likeliest neighbour here says, if there is one: which part. The first is believed more than others.
      const std::uint32_t any = from_begin & ~from_end, likeliest = any & (0u - any);
      const std::uint32_t says = any == 0 ? 0 : 1 + ((from_middle & likeliest) != 0) + 2 * (likeliest != 1);
      std::int16_t& a = cells.near[(says * 4 + depth) * 32 + side];
      std::int16_t& b = cells.leaf[(place.scale * 8 + leaf) * 4 + depth];
      if constexpr (kLearned && !kReads)
        if (depth < of_cells_.size()) of_cells_[depth] = a + b;
      if (decide(part.coder, interval, a, b, said >> depth, away >= middle, kLearned ? kLearnedOffsetRate : kOffsetRate) != 0) {
        begin = middle;
        from_begin = from_middle;
      } else {
        from_end = from_middle;
      }
    }
    return begin + plain(part.coder, interval, left, away - begin);
  }

  std::int32_t possible(std::int32_t range) const { return std::clamp(range, 0, 16 * limit_); }

  // Ranges around that a return beyond the last leaf may belong to, the likeliest first.
  std::array<std::int32_t, kAnchors> anchors(const PredictivePart<Coder>& part, const RowSurroundings& about,
                                             const Place& place) {
    const std::int32_t *up = place.up, *upper = place.upper, *last = part.last;
    if constexpr (kExpects) {
      const std::int32_t* const seen = about.expected + place.cell;
      const std::int32_t below = about.expected_below != nullptr ? about.expected_below[place.cell] : seen[0];
      return {seen[1], seen[0], below, seen[2], up[1], up[2], possible(seen[0] + part.bias), seen[-1], upper[1], last[1]};
    }
    return {up[1], up[2], up[3], upper[1], possible(up[1] + part.level), up[0], last[1], upper[2], last[2], upper[3]};
  }

  // Takes note of a return.
  void settle(PredictivePart<Coder>& part, const RowSurroundings& about, const Place& place, std::int32_t range,
              std::uint32_t leaf) {
    const std::uint32_t size = difference(range - place.base);
    part.size2 = (part.size2 + part.size1) / 2;
    part.size1 = size;
    part.mean += (static_cast<std::int32_t>(size) - static_cast<std::int32_t>(part.mean)) / 8;
    part.leaves = part.leaves >> 4 | leaf << 4;
    const std::int32_t level = range - place.up[1];
    const std::int32_t apart = level - part.level;
    const auto far = static_cast<std::int32_t>(kPositionLimits[place.scale][5]);  // 3.6 times the scale, in quarters
    if (!part.begun || std::abs(apart) > 4 * far) {
      part.level = level;
    } else {
      part.level += apart * 11 / 32;
    }
    if constexpr (kExpects) {
      if (expects(about, place.cell)) {
        const std::int32_t off = range - about.expected[place.cell], by = off - part.bias;
        part.miss += (static_cast<std::int32_t>(difference(by >> kDifferenceBits << kDifferenceBits)) - static_cast<std::int32_t>(part.miss)) / 4;
        if (std::abs(by) <= 4 * far) part.bias += by / 4;
      }
    }
    part.last_cell = place.cell;
    part.take(range);
  }

  Teaching teaching_;
  std::uint32_t step_;
  std::uint32_t start_;
  std::int32_t first_;
  bool free_;           // whether cells are
  std::int32_t half_;   // of a free cell: it begins so far below its middle; 0 for whole ones
  std::int32_t lowest_, highest_;  // range, sixteenths
  FreeCells free_cells_;
  bool quick_;
  Parts& parts_;
  std::array<std::int32_t, RiddleSamples::kOffsets> of_cells_{};  // what contexts said of a return's offset bits
};

}  // namespace lidarcodec
