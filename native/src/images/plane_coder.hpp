// One plane of a frame, row by row.
#pragma once
#include <algorithm>
#include <array>
#include <bit>
#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <cstring>
#include <utility>
#include <vector>

#include "base/error.hpp"
#include "images/decisions.hpp"
#include "images/flag_contexts.hpp"
#include "images/forms.hpp"
#include "images/guess.hpp"
#include "images/models.hpp"
#include "images/numbers.hpp"
#include "images/plane_rows.hpp"
#include "images/proportion.hpp"
#include "images/rows.hpp"
#include "images/symbols.hpp"

namespace lidarcodec {

template <class Coder, PlaneEffort Effort>
class PlaneCoder {
 public:
  static constexpr bool Quick = Effort == PlaneEffort::Quick, kFollows = Effort == PlaneEffort::Follows;
  using Models = PlaneModels<Effort>;
  using Stream = PlaneStream<Coder>;
  static constexpr bool kReads = Stream::kReads;

  // models: outlive this; they may have coded other frames before.
  PlaneCoder(const PlanePlan& plan, std::size_t columns, Models& models, Coder coder)
      : plan_(plan),
        columns_(static_cast<std::ptrdiff_t>(columns)),
        stream_(std::move(coder)),
        models_(models),
        rows_(columns),
        errors_(columns),
        sums_(columns),
        activity_(columns) {
    models_.prepare(plan.way);
    if (plan.way == PlaneWay::Constant) show_constant();
  }

  const PlaneRows& rows() const { return rows_; }
  PlaneRows& rows() { return rows_; }
  decltype(auto) finish() { return stream_.finish(); }

  // Goes on to a row: rows come from the top.
  void begin_row(std::size_t row, std::int32_t* values, const OtherPlanes& others) {
    row_ = row;
    values_ = values;
    others_ = others;
    known_ = 0;
    if (plan_.way == PlaneWay::Constant) {
      if constexpr (kReads) std::fill_n(values, columns_, plan_.constant);
      return;
    }
    if (row > 0) next_row();
    models_.proportion.next_row();
    const auto done = static_cast<int>(++models_.rows);
    rate_ = static_cast<std::int16_t>(kFirstRate / done + (kFollows ? 60 + 128'000 / (done + 512) : 450));
    stream_.make_room(static_cast<std::size_t>(columns_) * kMostDecisions);
  }

  // Writes or reads a cell of the row: cells come from the left. Raises Section or Truncated.
  void code(std::ptrdiff_t x) {
    if (plan_.way == PlaneWay::Constant || x < known_) return;
    if (plan_.way == PlaneWay::Sparse && x % kSparseRun == 0 && code_run(x)) return;
    if (is_attribute()) {
      code_cell<true>(x);
    } else {
      code_cell<false>(x);
    }
  }

 private:
  static constexpr int kFirstRate = 1500;
  static constexpr int kEqualRate = 2500, kHasRate = 1800;
  static constexpr std::size_t kMostDecisions = 64;
  static constexpr std::ptrdiff_t kSparseRun = 16;
  static constexpr std::size_t kSpreadWays = Models::kSpreadWays;
  static constexpr std::size_t kContexts = Models::kContexts;

  bool is_attribute() const { return plan_.form.role == PlaneRole::Attribute; }

  void show_constant() {
    const auto n = static_cast<std::size_t>(columns_);
    for (std::size_t row = 0; row < 3; ++row) {
      std::fill_n(rows_.value[row], n, plan_.constant);
      std::fill_n(rows_.has[row], n, static_cast<std::uint8_t>(is_attribute() || plan_.constant > 0));
    }
  }

  void next_row() {
    const PredictionErrors* const e = errors_[0];
    const std::int32_t* const off = rows_.error[0];  // the rows done, which are those above from now on
    rows_.value.next(static_cast<std::size_t>(columns_));
    rows_.error.next(static_cast<std::size_t>(columns_));
    rows_.has.next(static_cast<std::size_t>(columns_));
    rows_.equal.next(static_cast<std::size_t>(columns_));
    if constexpr (!Quick) errors_.next(static_cast<std::size_t>(columns_));
    if (row_ == 1) {
      rows_.value.repeat_last(static_cast<std::size_t>(columns_));
      rows_.has.repeat_last(static_cast<std::size_t>(columns_));
    }
    for (std::ptrdiff_t x = 0; x < columns_; ++x) {
      if constexpr (!Quick) sums_[x] = e[x - 1] + e[x] + e[x + 1];
      activity_[x] = 2 * off[x] + off[x + 1] + off[x - 1];
    }
  }

  // In the first row the left neighbour stands for those above.
  void look_left(std::ptrdiff_t x) {
    rows_.value[1][x] = rows_.value[1][x + 1] = rows_.value[1][x - 1] = rows_.value[2][x] = rows_.value[0][x - 1];
    rows_.has[1][x] = rows_.has[1][x + 1] = rows_.has[1][x + 2] = rows_.has[1][x - 1] = rows_.has[2][x] =
        rows_.has[0][x - 1];
    rows_.equal[1][x] = rows_.equal[1][x + 1] = rows_.equal[1][x - 1] = rows_.equal[0][x - 1];
    if constexpr (!Quick) sums_[x] = errors_[0][x - 1] + errors_[0][x - 1] + errors_[0][x - 1];
    activity_[x] = 4 * rows_.error[0][x - 1];
  }

  // Whether the next cells all have the usual value, of a sparse plane, where those above have. They are done then.
  bool code_run(std::ptrdiff_t x) {
    const std::uint8_t *here = rows_.equal[0] + x, *above = rows_.equal[1] + x;
    if (row_ == 0 || x + kSparseRun > columns_ || here[-1] == 0 || std::count(above, above + kSparseRun, 0) > 0)
      return false;
    const bool runs =
        !kReads && std::all_of(values_ + x, values_ + x + kSparseRun, [&](auto n) { return n == plan_.constant; });
    const std::uint32_t around = here[-2] | above[-1] << 1 | above[kSparseRun] << 2;
    if (stream_.template by_odds<1>(runs, {&models_.run_odds[around]}, kEqualRate) == 0) return false;
    known_ = x + kSparseRun;
    rows_.take_usual(x, kSparseRun, plan_.constant);
    std::fill_n(values_ + x, kSparseRun, plan_.constant);
    if constexpr (!Quick) std::fill_n(errors_[0] + x, kSparseRun, errors_[0][x - 1]);
    for (; x < known_; ++x) last_[others_.range->has[0][x]] = plan_.constant;
    return true;
  }

  template <bool Attribute>
  void code_cell(std::ptrdiff_t x) {
    if (row_ == 0) look_left(x);
    const std::int32_t value = kReads ? 0 : values_[x];
    std::uint32_t has = Attribute ? others_.range->has[0][x] : 1;
    if (plan_.way == PlaneWay::Sparse || others_.like != nullptr) {
      const std::int32_t same = plan_.way == PlaneWay::Sparse ? plan_.constant : original(*others_.like, x);
      if (code_equal<Attribute>(x, value == same, same, has)) {
        values_[x] = same;
        take_known(x, same, has);
        return;
      }
    }
    if constexpr (!Attribute) {
      has = code_has(x, value > 0);
      if (has == 0) {
        values_[x] = 0;
        take_known(x, 0, 0);
        return;
      }
    }
    values_[x] = code_number<Attribute>(x, value, has);
  }

  // A value of another plane: 0 where that has no return.
  std::int32_t original(const PlaneRows& other, std::ptrdiff_t x) const {
    return other.has[0][x] != 0 || is_attribute() ? other.value[0][x] : 0;
  }

  template <bool Attribute>
  std::uint32_t code_equal(std::ptrdiff_t x, bool equal, std::int32_t same, std::uint32_t has) {
    const std::uint32_t kind = Attribute ? others_.range->equal[0][x] | has << 1 : static_cast<std::uint32_t>(same > 0);
    const std::uint32_t result = stream_.by_odds(equal, equal_contexts(models_, rows_, others_, x, kind), kEqualRate);
    rows_.equal[0][x] = static_cast<std::uint8_t>(result);
    return result;
  }

  std::uint32_t code_has(std::ptrdiff_t x, bool has) {
    const std::uint32_t result = stream_.by_odds(has, has_contexts(models_, rows_, x, row_, activity_[x]), kHasRate);
    rows_.has[0][x] = static_cast<std::uint8_t>(result);
    return result;
  }

  // A number that is known without being coded here.
  void take_known(std::ptrdiff_t x, std::int32_t value, std::uint32_t has) {
    rows_.leaf[0][x] = kCentralLeaf;
    rows_.scale[0][x] = rows_.scale[0][x - 1];
    if constexpr (!Quick) errors_[0][x] = errors_[0][x - 1];
    if (is_attribute() || value > 0) {
      rows_.has[0][x] = 1;
      rows_.value[0][x] = value;
      rows_.error[0][x] = others_.like != nullptr ? others_.like->error[0][x] : 0;
      last_[has] = value;
    } else {
      rows_.has[0][x] = 0;
      rows_.value[0][x] = others_.like != nullptr ? others_.like->value[0][x] : rows_.value[0][x - 1];
      rows_.error[0][x] = rows_.error[0][x - 1];
    }
  }

  template <bool Attribute>
  std::int32_t code_number(std::ptrdiff_t x, std::int32_t value, std::uint32_t has) {
    const std::int32_t *here = rows_.value[0] + x, *above = rows_.value[1] + x, *second = rows_.value[2] + x;
    const Near near = {here[-1], above[0], above[1], above[-1], here[-2], second[0]};
    PerPrediction p = {near.left,
                       near.above,
                       near.left + near.above - near.left_above,
                       near.right_above,
                       2 * near.left - near.second_left,
                       near.average()};
    const std::int32_t mate = Attribute && others_.mate != nullptr ? others_.mate->value[0][x] : -1;
    std::uint32_t around = 0;
    if constexpr (Attribute) {
      const std::uint8_t *left = others_.range->has[0] + x, *above_has = others_.range->has[1] + x;
      const std::array<std::uint8_t, 3> first = {left[-1], left[-1], left[-1]};
      const std::uint8_t* up = row_ > 0 ? above_has : first.data() + 1;
      around = has | left[-1] << 1 | up[0] << 2;
      p[3] = p[5];
      if (mate >= 0) p[3] = models_.proportion.of(mate, has ? others_.range->value[0][x] : 0, plan_.most);
      p[4] = left[-1] == has ? (2 * near.left + near.second_left + 1) / 3 : last_[has];
      p[5] = up[0] == has    ? (near.above + near.second_above) / 2
             : up[1] == has  ? near.right_above
             : up[-1] == has ? near.left_above
                             : last_[has];
    }
    if constexpr (kFollows) {
      const std::int32_t* was = rows_.was[0] + x;
      p[6] = was[0] != kNothing ? was[0] : near.average();
      p[7] = was[0] != kNothing && was[-1] != kNothing ? near.left + was[0] - was[-1] : p[6];
      if constexpr (Attribute)
        if (others_.kin != nullptr) p[7] = others_.kin->in_proportion(x, row_ == 0, near.average(), plan_.most, p[7]);
    }
    Guess guess{};
    PredictionErrors sums{};
    if constexpr (Quick) {
      guess.eighths = 8 * (mate >= 0   ? p[3]
                           : Attribute ? clamped_gradient(p[4], p[5], near.left_above)
                                       : clamped_gradient(near.left, near.above, near.left_above));
    } else {
      const PredictionErrors& left = errors_[0][x - 1];
      sums = sums_[x] + left + left + errors_[0][x - 2];
      guess = guess_of<kFollows ? 8 : 6>(p, sums);
    }

    const std::int32_t* off = rows_.error[0] + x;
    const auto activity = static_cast<std::uint32_t>(2 * off[-1] + off[-2] + activity_[x]);
    const std::uint32_t calm = quarter_log(activity);
    const int steep = static_cast<int>(quarter_log(near.slope())) - static_cast<int>(calm);
    const auto size_of_guess = static_cast<std::uint32_t>(std::clamp(guess.eighths, 0, plan_.most * 8));
    const bool by_size = kFollows && Attribute && plan_.most > 255;
    const int way = by_size ? static_cast<int>(quarter_log(size_of_guess)) / 4 : (steep + 18) / 2;
    std::uint32_t& spread =
        models_.spread[std::min(127u, calm) * kSpreadWays + static_cast<std::size_t>(std::clamp(way, 0, 15))];
    const std::uint32_t turn = Attribute ? around
                                         : static_cast<std::uint32_t>(near.above > near.left) << 1 |
                                               static_cast<std::uint32_t>(near.right_above > near.above);
    std::int32_t& bias = models_.bias[std::min(63u, guess.least) * 16 + turn];
    const std::int32_t eighths = std::clamp(guess.eighths + (bias >> 8), 0, plan_.most * 8);
    const std::int32_t expected = (eighths + 4) >> 3;
    const std::uint32_t share = (spread * (Attribute ? 3 : 2)) >> 8;
    const auto scale = std::min(16u, static_cast<std::uint32_t>(std::bit_width(share)));
    const Bins bins = {expected - (scale > 0 ? 1 << (scale - 1) : 0), scale};

    std::uint32_t leaf = 0;
    if (Attribute && plan_.way == PlaneWay::Symbols) {
      value = static_cast<std::int32_t>(code_symbol(x, value, has, around, expected, spread, p[5]));
      if (value > plan_.most) throw Error(ErrorCode::Section, "a value of a plane beyond its bits");
      leaf = leaf_of((value - bins.start) >> scale);
    } else {
      const auto distance = [&](std::int32_t from) { return distance_class(from - expected, scale); };
      const std::uint32_t fine =
          scale == 0 ? std::min(3u, spread >> 3) : (scale > 3 ? share >> (scale - 3) : share << (3 - scale)) & 3u;
      const std::uint32_t magnitude = quarter_log(static_cast<std::uint32_t>(expected));
      std::uint32_t cross, extra, size;
      if constexpr (Attribute) {
        cross = others_.range->leaf[0][x] * 8u + around;
        extra = (others_.mate != nullptr ? others_.mate->leaf[0][x] * 2u : 0u) + has;
        size = plan_.most < 256 ? static_cast<std::uint32_t>(expected) : magnitude;
      } else {
        const std::uint8_t *left = rows_.has[0] + x, *up = rows_.has[1] + x;
        cross = left[-1] | left[-2] << 1 | up[0] << 2 | up[-1] << 3 | up[1] << 4;
        extra = magnitude;
        size = std::min(255u, calm);
      }
      const std::uint32_t base = (scale * 4 + fine) * 8 + (scale == 0 ? static_cast<std::uint32_t>(eighths) & 7u : 0u);
      const std::uint32_t beside = distance(near.above) * kDistanceClasses + distance(near.left);
      std::array<std::uint32_t, kContexts> of;
      if constexpr (Quick) {
        of = {base, beside, size};
      } else {
        const std::array<std::uint32_t, 7> alone = {
            base,
            beside,
            distance(near.right_above) * kDistanceClasses + distance(near.left_above),
            distance(near.second_left) * kDistanceClasses + distance(near.second_above),
            cross,
            std::min(127u, extra),
            size};
        std::copy(alone.begin(), alone.end(), of.begin());
        if (mate >= 0) {
          of[2] = distance(p[3]) * kDistanceClasses + std::min(12u, quarter_log(static_cast<std::uint32_t>(mate)) / 2);
          of[3] = distance(p[3]) * kDistanceClasses + std::min(12u, scale);
        }
        if constexpr (kFollows) {
          const std::int32_t* was = rows_.was[0] + x;
          const auto past = [&](std::int32_t from) { return from == kNothing ? kDistanceClasses : distance(from); };
          const std::uint32_t fit = std::min(15u, quarter_log(static_cast<std::uint32_t>(sums.of[6]) >> scale) / 2);
          of[7] = past(was[0]) * 14 + past(p[7]);
          of[8] = past(was[0]) * 16 + fit;
          of[9] = past(was[-1]) * 14 + past(was[1]);
          if constexpr (Attribute) {
            const PlaneRows& range = *others_.range;
            const std::int32_t range_was = range.was[0][x];
            const auto moved = static_cast<std::uint32_t>(std::abs(range.value[0][x] - range_was));
            const std::uint32_t away = range_was == kNothing ? 15 : std::min(14u, quarter_log(moved) / 2);
            of[10] = past(was[0]) * 16 + away;
          } else {
            of[10] = others_.like != nullptr ? distance(original(*others_.like, x)) * 16 + std::min(15u, calm / 4)
                                             : static_cast<std::uint32_t>(row_ % 128);
          }
        }
      }
      Cells* weights = nullptr;
      if constexpr (kFollows) weights = models_.weights.data() + scale * kContexts * 2;
      std::array<Cells*, kContexts> contexts;
      for (std::size_t i = 0; i < kContexts; ++i) contexts[i] = models_.cells.data() + models_.begin[i] + 2 * of[i];
      value = models_.numbers.template code<Quick>(stream_, value, bins, near, contexts, rate_, Attribute ? 0 : 1,
                                                   plan_.most, leaf, weights);
    }

    const std::int32_t wrong = std::abs(value - expected);
    rows_.value[0][x] = value;
    rows_.error[0][x] = std::min(wrong, 1 << 18);
    rows_.leaf[0][x] = static_cast<std::uint8_t>(leaf);
    rows_.scale[0][x] = static_cast<std::uint8_t>(scale);
    if constexpr (!Quick) errors_[0][x] = errors_of(p, value);
    const auto now = static_cast<std::int32_t>(std::min(static_cast<std::uint32_t>(wrong) * 16, spread * 8 + 64));
    spread =
        static_cast<std::uint32_t>(static_cast<std::int32_t>(spread) + (now - static_cast<std::int32_t>(spread)) / 16);
    const std::int32_t most = 32 << scale;
    bias = std::clamp(bias + 4 * std::clamp(value * 8 - eighths, -most, most), -(1 << 20), 1 << 20);
    if constexpr (Attribute) {
      if (mate >= 0) models_.proportion.learn(value, mate);
      before_last_[has] = last_[has];
    }
    last_[has] = value;
    return value;
  }

  std::uint32_t code_symbol(std::ptrdiff_t x, std::int32_t value, std::uint32_t has, std::uint32_t around,
                            std::int32_t expected, std::uint32_t spread, std::int32_t above) {
    const auto guess = static_cast<std::uint32_t>(expected);
    const auto last = static_cast<std::uint32_t>(last_[has]), before = static_cast<std::uint32_t>(before_last_[has]);
    const auto up = static_cast<std::uint32_t>(above);
    const std::uint32_t width = quarter_log(spread);
    std::array<std::uint32_t, Models::kSymbolContexts> of;
    const std::array<std::uint32_t, 8> alone = {
        (guess >> 2) * 4 + std::min(3u, width / 8),
        has * 256 + last,
        has * 256 + up,
        ((last >> 3) * 32 + (up >> 3)) * 2 + has,
        (last >> 3) * 32 + (before >> 3),
        others_.range->leaf[0][x] * 8u + around,
        others_.mate != nullptr ? others_.mate->leaf[0][x] * 32u + (guess >> 3) : has,
        (guess >> 3) * 32 + std::min(31u, width)};
    std::copy_n(alone.begin(), std::min(of.size(), alone.size()), of.begin());
    if constexpr (kFollows) {
      const std::int32_t was = rows_.was[0][x];
      const std::uint32_t past = was == kNothing ? 0 : static_cast<std::uint32_t>(std::min(was, 255));
      const std::int32_t range_was = others_.range->was[0][x];
      const auto moved = static_cast<std::uint32_t>(std::abs(others_.range->value[0][x] - range_was));
      const std::uint32_t away = range_was == kNothing ? 3 : std::min(2u, quarter_log(moved) / 4);
      of[8] = has * 256 + past;
      of[9] = ((past >> 3) * 32 + (last >> 3)) * 4 + away;
    }
    return models_.symbols.front().code(stream_, static_cast<std::uint32_t>(value), of, rate_);
  }

  PlanePlan plan_;
  std::ptrdiff_t columns_, known_ = 0;  // known: cells of the row before this one are done
  std::size_t row_ = 0;
  std::int32_t* values_ = nullptr;
  OtherPlanes others_;
  Stream stream_;
  Models& models_;
  std::int16_t rate_ = 0;
  PlaneRows rows_;
  Rows<PredictionErrors, 2> errors_;
  std::vector<PredictionErrors> sums_;                  // of the errors of each prediction in three cells above
  std::vector<std::int32_t> activity_;                  // the same of the expectation
  std::array<std::int32_t, 2> last_{}, before_last_{};  // values of the row, without and with a return
};

}  // namespace lidarcodec
