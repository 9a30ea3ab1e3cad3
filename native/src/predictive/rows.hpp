// Codes rows of ranges: the order of the decisions, and the updates of the models.
#pragma once
#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>

#include "base/error.hpp"
#include "bits/wide_coder.hpp"
#include "network/net.hpp"
#include "network/samples.hpp"
#include "predictive/forms.hpp"
#include "predictive/free_cells.hpp"
#include "predictive/model.hpp"
#include "predictive/net_inputs.hpp"
#include "predictive/offset_decisions.hpp"
#include "predictive/row_state.hpp"

namespace lidarcodec {

// For kNetwork: the network, and where its training samples go. One of them may be missing.
struct NetworkUse {
  const RiddleNet* net = nullptr;
  RiddleSamples* samples = nullptr;
};

// Codes rows of ranges; `Coder` is WideEncoder or WideDecoder, `Forms` those of predictive/forms.hpp for the processor.
// The four quarters of a row, or two rows of a slab, are interleaved return by return. A processor then works on one
// while another waits, and loads the weights of a network once for all. kNetwork: a network gives the prior, and
// returns beyond the last leaf have a second tree.
template <class Coder, class Forms, bool kExpects, bool kNetwork>
class PredictiveRows : OffsetDecisions<Coder, Forms, kExpects, kNetwork> {
  using Decisions = OffsetDecisions<Coder, Forms, kExpects, kNetwork>;
  using Decisions::expects, Decisions::first_offsets, Decisions::half_, Decisions::kFlatRowLeft, Decisions::leaves;
  using Decisions::model_, Decisions::of_cells_, Decisions::offset, Decisions::quick_;
  using typename Decisions::Pending;

 public:
  using Decisions::kReads;
  using Parts = PredictiveParts<Coder>;

  // cells: the quantisation; limit: the largest range, in cells; network: for kNetwork; quick: never with kNetwork.
  PredictiveRows(PredictiveModel& model, const NetworkUse& network, const RangeCells& cells, std::int32_t limit,
                 bool quick, Parts& parts)
      : Decisions(model, limit, cells.free ? 8 : 0, quick),
        network_(network),
        step_(cells.step),
        start_(kStartDifference / step_ + 5),
        first_(static_cast<std::int32_t>(kStartRange / step_ * 16)),
        free_(cells.free),
        lowest_(-2 * half_),
        highest_(16 * limit + 2 * half_),
        free_cells_(step_),
        parts_(parts) {
    model.begin(quick_);
  }

  // Codes the ranges of a row's returns, its quarters interleaved. Raises Section or Truncated.
  void code(const RowTask& row) {
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

  // Codes two rows of a slab, interleaved. Each continues from its end in the last slab, and updates it.
  void code(const RowTask& a, RowEnd& end_a, const RowTask& b, RowEnd& end_b) {
    const std::array<RowEnd*, 2> ends = {&end_a, &end_b};
    const std::array<const RowTask*, 2> rows = {&a, &b};
    for (std::size_t p = 0; p < 2; ++p) {
      if (rows[p]->count > 0) parts_[p].resume(rows[p]->count, base_of(*rows[p], 0), *ends[p]);
      if constexpr (!kReads) parts_[p].coder.make_room(rows[p]->count * kMostDecisions);
    }
    code_in_turns<2>(rows, {a.count, b.count});
    for (std::size_t p = 0; p < 2; ++p)
      if (rows[p]->count > 0) *ends[p] = parts_[p].end();
  }

  std::uint32_t start() const { return start_; }  // the first difference, sixteenths of a cell
  std::int32_t first() const { return first_; }   // the first range, sixteenths of a cell

 private:
  // A return's first difference and range if there is none before: 30 range steps in sixteenths, and 2500 range steps
  // (5 m of an HDL-64E).
  static constexpr std::uint32_t kStartDifference = 480, kStartRange = 2500;
  // Decisions of a return, at most: two trees of four, the modelled offset bits, the octaves, and four to spare for
  // plain bits.
  static constexpr std::size_t kMostDecisions = 8 + OffsetCells::kDepth + kMaxOctaves + 4;
  // Exponential smoothing (Brown 1956) of the level: gain 11 of 32.
  static constexpr std::int32_t kLevelGain = 11;
  // Differences above this position limit, 3.6 times the scale, are outliers: they reset the level and do not move the
  // bias.
  static constexpr std::size_t kOutlierLimit = 5;

  static constexpr auto &kAll = all_contexts<kExpects>(), &kQuick = quick_contexts<kExpects>();

  // The base of the first difference of a row, or of a part of one.
  std::int32_t base_of(const RowTask& row, std::size_t first) const {
    return row.about.above != nullptr ? row.about.above[row.cells[first]] : first_;
  }

  // Codes the returns of N parts: interleaved as long as all have some, then one by one.
  template <std::size_t N>
  void code_in_turns(const std::array<const RowTask*, N>& rows, const std::array<std::size_t, N>& counts) {
    const std::size_t all = *std::min_element(counts.begin(), counts.end()),
                      most = *std::max_element(counts.begin(), counts.end());
    Forms::run([&] {
      for (std::size_t i = 0; i < all; ++i) step<N>(rows);
      for (std::size_t i = all; i < most; ++i)
        for (std::size_t p = 0; p < N; ++p)
          if (i < counts[p]) step_one(*rows[p], p);
    });
  }

  // Not inlined, like the other rare cases: it would be compiled in every form, which takes minutes.
  [[gnu::noinline]] void step_one(const RowTask& row, std::size_t part) { step<1>({&row}, part); }

  // Codes a return of each of N parts, from part `first` on, of their rows.
  template <std::size_t N>
  void step(const std::array<const RowTask*, N>& rows, std::size_t first = 0) {
    PredictivePart<Coder>* const parts = parts_.data() + first;
    std::array<Pending, N> pending;
    std::array<WideInterval, N> interval;
    std::array<std::uint32_t, N> node;
    std::array<std::uint32_t, N> leaf{}, away{};
    for (std::size_t p = 0; p < N; ++p) {
      find_contexts(parts[p], rows[p]->about, rows[p]->cells[parts[p].next], pending[p]);
      interval[p] = parts[p].interval;
      node[p] = 1;
      if constexpr (!kReads)
        if (!free_) locate(pending[p], (rows[p]->ranges[pending[p].cell] - pending[p].base) / 16, leaf[p], away[p]);
    }
    if constexpr (kNetwork) {
      if (network_.net != nullptr) {
        std::array<NetValues*, N> values;
        for (std::size_t p = 0; p < N; ++p) values[p] = &pending[p].net.values;
        network_.net->run(values);
      } else {
        for (Pending& at : pending) at.net.values.out.fill(0);
      }
      for (Pending& at : pending)
        Forms::template mix<kAll>(model_.cells(), at.slots, at.net.values.out.data(), model_.mixing_weights[at.scale],
                                  at.net.context_odds.data(), at.chances);
    }
    if constexpr (!kReads) {
      if (free_) {
        const FreeChoice choice(free_cells_, step_);
        for (std::size_t p = 0; p < N; ++p)
          locate(pending[p],
                 choice.cell(*rows[p], parts[p].next, parts[p].stop, pending[p].base, leaves(), pending[p].scale,
                             pending[p].chances),
                 leaf[p], away[p]);
      }
    }
#pragma GCC unroll 4
    for (int level = 3; level >= 0; --level) {
#pragma GCC unroll 4
      for (std::size_t p = 0; p < N; ++p) {
        const auto probability = static_cast<std::uint32_t>(pending[p].chances.of[node[p]]);
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
    if constexpr (kNetwork) {
      if (network_.net != nullptr)
        for (std::size_t p = 0; p < N; ++p)
          of_leaf[p] = network_.net->template leaf_odds<Forms>(pending[p].net.values, node[p] - 16);
    }
    for (std::size_t p = 0; p < N; ++p) {
      learn(pending[p], kWalks[node[p]]);
      if constexpr (kNetwork)
        Forms::learn_mixing(model_.mixing_weights[pending[p].scale], pending[p].net.values.out.data(),
                            pending[p].net.context_odds.data(), pending[p].chances, kWalks[node[p]]);
      PredictivePart<Coder>& part = parts[p];
      const std::uint32_t came = node[p] - 16;
      const bool down = came < 8;
      const std::uint32_t in =
          offset(part, interval[p], rows[p]->about, pending[p], down ? 7 - came : came - 8, down, of_leaf[p], away[p]);
      part.interval = interval[p];
      if constexpr (kNetwork && !kReads) {
        if (network_.samples != nullptr && network_.samples->next_is_taken())
          network_.samples->take(pending[p].net.values, came, first_offsets(pending[p].scale, came, in),
                                 pending[p].chances.of.data(), of_cells_);
      }
      const auto d = static_cast<std::int32_t>(in);
      const std::int32_t number = down ? -1 - d : d, whole = pending[p].base + 16 * number;
      const std::int32_t range = free_ ? free_cells_.middle(pending[p].base, number) : whole;
      if constexpr (kReads) {
        if (range < lowest_ || range > highest_)
          throw Error(ErrorCode::Section, "a range beyond what the sensor can give");
      }
      rows[p]->ranges[pending[p].cell] = range;
      update_state(part, rows[p]->about, pending[p], range, came);
      rows[p]->sizes[pending[p].cell] = part.size1;
      ++part.next;
    }
  }

  // The leaf and the distance of a cell.
  void locate(const Pending& pending, std::int32_t number, std::uint32_t& leaf, std::uint32_t& away) const {
    away = static_cast<std::uint32_t>(number < 0 ? -1 - number : number);
    const std::uint32_t l = leaves().of(pending.scale, away);
    leaf = number < 0 ? 7 - l : 8 + l;
  }

  // The base of free cells.
  static std::int32_t free_base(const PredictivePart<Coder>& part, const RowSurroundings& about,
                                const Pending& pending) {
    const std::int32_t last = part.last[0];
    if constexpr (kExpects) {
      if (expects(about, pending.cell))
        return FreeCells::base(last, pending.up[1] + part.level, about.expected[pending.cell] + part.bias);
    }
    return last;
  }

  // Finds the contexts of the next return of a part.
  void find_contexts(const PredictivePart<Coder>& part, const RowSurroundings& about, std::uint32_t cell,
                     Pending& pending) {
    pending.cell = cell;
    if (about.upper == nullptr) [[unlikely]]
      pending.flat_row.fill(part.last[0]);
    const std::int32_t* const flat_row = pending.flat_row.data() + kFlatRowLeft - 1;
    pending.up = about.above != nullptr ? about.above + cell - 1 : flat_row;
    pending.upper = about.upper != nullptr ? about.upper + cell - 1 : flat_row;
    const std::int32_t base = pending.base = free_ ? free_base(part, about, pending) : part.last[0];
    const std::uint32_t mean = (5 * part.size1 + 3 * part.size2 + about.sizes_around[cell]) / 16;
    pending.scale = scale_class(mean);
    Known known;
    known.around = {part.last + 1, pending.up, pending.upper, base, part.level >> (kDifferenceBits - 2)};
    known.scale = pending.scale;
    known.leaves = part.leaves;
    known.firing = about.first_firing + about.firings[about.columns[cell]];
    known.returns = about.returns[cell];
    known.mean_size = part.mean;
    known.last_size = part.size1;
    known.up_size = about.sizes[cell];
    if constexpr (kExpects) {
      known.expected = {about.expected + cell - 1,
                        about.above != nullptr ? about.expected_above + cell - 1 : pending.up, pending.up, base,
                        part.bias >> (kDifferenceBits - 2)};
      known.seen_size = part.miss;
    }
    Forms::template find<kExpects>(known, pending.slots);
    if constexpr (kNetwork) {
      find_net_inputs(part, about, pending);
    } else {
      add_up(pending);
    }
  }

  // These two use the contexts of the kind.
  void add_up(Pending& pending) {
    if (!quick_) [[unlikely]]
      return add_up_all(pending);
    Forms::template add_up<kQuick>(model_.cells(), pending.slots, pending.chances);
  }
  void learn(const Pending& pending, const Walk& walked) {
    if constexpr (kNetwork) {
      Forms::template learn<kAll, true>(model_.cells(), pending.slots, pending.chances, walked);
    } else {
      if (!quick_) [[unlikely]]
        return learn_all(pending, walked);
      Forms::template learn<kQuick, false>(model_.cells(), pending.slots, pending.chances, walked);
    }
  }
  [[gnu::noinline]] void add_up_all(Pending& pending) {
    Forms::template add_up<kAll>(model_.cells(), pending.slots, pending.chances);
  }
  [[gnu::noinline]] void learn_all(const Pending& pending, const Walk& walked) {
    Forms::template learn<kAll, false>(model_.cells(), pending.slots, pending.chances, walked);
  }

  // Computes the inputs of the network.
  void find_net_inputs(const PredictivePart<Coder>& part, const RowSurroundings& about, Pending& pending) {
    const std::uint32_t cell = pending.cell;
    Surroundings s{};
    s.base = pending.base;
    s.last = part.last;
    s.up = pending.up + 1;
    s.upper = pending.upper + 1;
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
    s.scale = pending.scale;
    s.leaves = part.leaves;
    s.row = about.row;
    s.gap = part.begun && cell > part.last_cell ? cell - part.last_cell : 1u;
    s.step = step_;
    s.begun = part.begun;
    Forms::template inputs<kExpects>(s, pending.net.values.in.data());
  }

  // Updates the state of a part after a return.
  void update_state(PredictivePart<Coder>& part, const RowSurroundings& about, const Pending& pending,
                    std::int32_t range, std::uint32_t leaf) {
    const std::uint32_t size = difference(range - pending.base);
    part.size2 = (part.size2 + part.size1) / 2;
    part.size1 = size;
    part.mean += (static_cast<std::int32_t>(size) - static_cast<std::int32_t>(part.mean)) / 8;
    part.leaves = part.leaves >> 4 | leaf << 4;
    const std::int32_t level = range - pending.up[1];
    const std::int32_t apart = level - part.level;
    const auto outlier =
        static_cast<std::int32_t>(kPositionLimits[pending.scale][kOutlierLimit]);  // quarters of a cell
    if (!part.begun || std::abs(apart) > 4 * outlier) {
      part.level = level;
    } else {
      part.level += apart * kLevelGain / 32;
    }
    if constexpr (kExpects) {
      if (expects(about, pending.cell)) {
        const std::int32_t off = range - about.expected[pending.cell], by = off - part.bias;
        part.miss += (static_cast<std::int32_t>(difference(by >> kDifferenceBits << kDifferenceBits)) -
                      static_cast<std::int32_t>(part.miss)) /
                     4;
        if (std::abs(by) <= 4 * outlier) part.bias += by / 4;
      }
    }
    part.last_cell = pending.cell;
    part.take(range);
  }

  NetworkUse network_;
  std::uint32_t step_;
  std::uint32_t start_;
  std::int32_t first_;
  bool free_;                      // free cells
  std::int32_t lowest_, highest_;  // limits of ranges, sixteenths of a cell
  FreeCells free_cells_;
  Parts& parts_;
};

}  // namespace lidarcodec
