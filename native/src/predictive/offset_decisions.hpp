// The distance of a return within its leaf, or beyond the last one, as decisions that know the returns around it.
#pragma once
#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>
#include <type_traits>

#include "base/error.hpp"
#include "bits/wide_coder.hpp"
#include "network/net.hpp"
#include "network/samples.hpp"
#include "predictive/forms.hpp"
#include "predictive/model.hpp"
#include "predictive/range_decisions.hpp"
#include "predictive/row_state.hpp"

namespace lidarcodec {

// The offset decisions of rows; parameters as of PredictiveRows (predictive/rows.hpp).
template <class Coder, class Forms, bool kExpects, bool kNetwork>
class OffsetDecisions : protected RangeDecisions<Coder> {
  using Decisions = RangeDecisions<Coder>;
  using Decisions::beyond_leaf, Decisions::decide, Decisions::limit_, Decisions::plain;

 protected:
  using Decisions::kReads, Decisions::model_;

  // half: half a free cell, from its lower end to its middle; 0 for whole cells. quick: never with kNetwork.
  OffsetDecisions(PredictiveModel& model, std::int32_t limit, std::int32_t half, bool quick)
      : Decisions(model, limit), half_(half), quick_(!kNetwork && quick) {}

  static constexpr std::size_t kFlatRow = 16,
                               kFlatRowLeft = 4;  // cells of a row that stands for a missing one; those to the left

  struct NetworkState {
    NetValues values;
    alignas(32) std::array<std::int16_t, kSlotCells> context_odds;  // the log odds of the contexts
  };
  struct NoNetwork {};

  // The return that a part codes next.
  struct Pending {
    std::uint32_t cell, scale;
    std::int32_t base;               // the base of its difference, sixteenths of a cell
    const std::int32_t *up, *upper;  // the rows above, from the cell to the left of this one
    Slots slots;
    Probabilities chances;
    [[no_unique_address]] std::conditional_t<kNetwork, NetworkState, NoNetwork> net;
    std::array<std::int32_t, kFlatRow> flat_row;  // stands for missing rows above: the base everywhere
  };

  const Leaves& leaves() const {
    if constexpr (kNetwork) return kLeaves;
    return quick_ ? kQuickLeaves : kLeaves;
  }

  // The distances of the neighbours, the likeliest first.
  NearRanges near_ranges(const PredictivePart<Coder>& part, const RowSurroundings& about, const Pending& pending,
                         bool down) {
    const std::int32_t *up = pending.up, levelled = up[1] + part.level, origin = pending.base - half_;
    if constexpr (kExpects) {
      if (expects(about, pending.cell)) {
        const std::int32_t seen = about.expected[pending.cell] + part.bias;
        return Forms::near({seen, up[1], up[2], part.last[1], pending.upper[1], up[0], part.last[2], levelled}, origin,
                           down);
      }
    }
    return Forms::near({up[1], up[2], part.last[1], pending.upper[1], up[0], part.last[2], levelled, up[3]}, origin,
                       down);
  }

  static bool expects(const RowSurroundings& about, std::uint32_t cell) {
    return (about.returns[cell] >> 11 & 1u) != 0;
  }

  // Codes the distance of a return within its leaf or beyond the last one, and returns it. net_odds: the network's log
  // odds of the first offset bit. Each further bit takes half as much: where the logarithm of the density is linear,
  // half the distance gives half the log odds.
  std::uint32_t offset(PredictivePart<Coder>& part, WideInterval& interval, const RowSurroundings& about,
                       const Pending& pending, std::uint32_t leaf, bool down, std::int32_t net_odds,
                       std::uint32_t away) {
    std::uint32_t begin = leaves().begins[pending.scale][leaf], left = leaves().bits[pending.scale][leaf];
    if (leaf < 7 && left == 0) return begin;
    if constexpr (kNetwork) {
      if (leaf == 7) {
        const auto least = static_cast<std::int32_t>(begin);
        return beyond_leaf(part.coder, interval,
                           {anchors(part, about, pending), pending.base - half_, down, least, pending.scale}, begin,
                           away);
      }
    }
    if constexpr (!kNetwork) {
      if (quick_ && leaf < 7) return begin + plain(part.coder, interval, left, away - begin);
    }
    OffsetCells& cells = model_.offsets;
    const NearRanges near = near_ranges(part, about, pending, down);
    std::uint32_t end = begin + (1u << left);
    std::uint32_t from_begin = Forms::from(near, begin),
                  from_end = Forms::from(near, end);  // neighbours at least so far
    if (leaf == 7) {
      for (std::uint32_t octave = 0;; ++octave) {
        if (octave >= kMaxOctaves || this->is_too_far(begin))
          throw Error(ErrorCode::Section, "a range beyond what the sensor can give");
        const std::uint32_t here = from_begin & ~from_end, beyond = from_end;
        const std::uint32_t neighbours = (here & 3) | (beyond & 3) << 2 | (here & 12) << 2 | (beyond & 8) << 3;
        const std::uint32_t more =
            decide(part.coder, interval, cells.more[octave * 128 + neighbours],
                   cells.more_of_scale[pending.scale * 32 + octave], kOctaveLogOdds, away >= end);
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
      // The likeliest neighbour in this interval, if there is one, predicts the half. The first neighbour has cells of
      // its own.
      const std::uint32_t any = from_begin & ~from_end, likeliest = any & (0u - any);
      const std::uint32_t prediction = any == 0 ? 0 : 1 + ((from_middle & likeliest) != 0) + 2 * (likeliest != 1);
      std::int16_t& a = cells.near[(prediction * 4 + depth) * 32 + side];
      std::int16_t& b = cells.leaf[(pending.scale * 8 + leaf) * 4 + depth];
      if constexpr (kNetwork && !kReads)
        if (depth < of_cells_.size()) of_cells_[depth] = a + b;
      if (decide(part.coder, interval, a, b, net_odds >> depth, away >= middle,
                 kNetwork ? kNetworkOffsetRate : kOffsetRate) != 0) {
        begin = middle;
        from_begin = from_middle;
      } else {
        from_end = from_middle;
      }
    }
    return begin + plain(part.coder, interval, left, away - begin);
  }

  std::int32_t bounded(std::int32_t range) const { return std::clamp(range, 0, 16 * limit_); }

  // Candidates for anchors (beyond.hpp), the likeliest first.
  std::array<std::int32_t, kAnchors> anchors(const PredictivePart<Coder>& part, const RowSurroundings& about,
                                             const Pending& pending) {
    const std::int32_t *up = pending.up, *upper = pending.upper, *last = part.last;
    if constexpr (kExpects) {
      const std::int32_t* const seen = about.expected + pending.cell;
      const std::int32_t below = about.expected_below != nullptr ? about.expected_below[pending.cell] : seen[0];
      return {seen[1],  seen[0],  below,  seen[2], up[1], up[2], bounded(seen[0] + part.bias),
              seen[-1], upper[1], last[1]};
    }
    return {up[1], up[2], up[3], upper[1], bounded(up[1] + part.level), up[0], last[1], upper[2], last[2], upper[3]};
  }

  std::int32_t half_;
  bool quick_;
  std::array<std::int32_t, RiddleSamples::kOffsets> of_cells_{};  // log odds of the offset bits by their cells
};

}  // namespace lidarcodec
