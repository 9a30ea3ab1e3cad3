// Directions of the points of a range image, told by those of the points before (docs/wire-format-clouds.md,
// "Directions"). Whole steps of a turn, from -U/2 on, U steps in all.
#pragma once
#include <algorithm>
#include <cstdint>
#include <cstdlib>
#include <vector>

namespace lidarcodec {

enum class DirectionForm : std::uint8_t { ByColumn, ByRow };

class Directions {
 public:
  // step: by which directions of neighbours in a row differ, of ByRow.
  Directions(DirectionForm form, std::uint32_t turn, std::int32_t step, std::size_t rows, std::size_t columns)
      : form_(form), turn_(turn), step_(step), rows_(rows), columns_(form == DirectionForm::ByColumn ? columns : 0) {}

  // The direction that the next point is expected in, and the context of what is left.
  std::int32_t told(std::size_t row, std::size_t column) {
    const Row& of = rows_[row];
    if (form_ == DirectionForm::ByRow) return wrapped(of.seen ? std::int64_t{of.k} + step_ : last_);
    const Column& here = columns_[column];
    position_ =
        here.seen ? here.position : wrapped(last_position_ + stepped(static_cast<std::int64_t>(column) - last_column_));
    return wrapped(std::int64_t{position_} + (of.seen ? of.k - columns_[of.column].position : last_));
  }

  std::uint8_t context(std::size_t row, std::size_t column) const {
    const Row& of = rows_[row];
    if (form_ == DirectionForm::ByRow) return static_cast<std::uint8_t>(3 * of.left);
    const Column& here = columns_[column];
    return static_cast<std::uint8_t>(here.seen ? 3 * of.left + here.left : 9 + of.left);
  }

  // The point's direction is `left` steps from what was told; gives it.
  std::int32_t take(std::size_t row, std::size_t column, std::int32_t told, std::int32_t left) {
    const std::int32_t k = wrapped(std::int64_t{told} + left);
    Row& of = rows_[row];
    const auto kind = static_cast<std::uint8_t>(std::min(std::abs(left), 2));
    if (form_ == DirectionForm::ByColumn) {
      Column& here = columns_[column];
      if (of.seen)
        position_ = wrapped(std::int64_t{position_} + left);
      else
        last_ = wrapped(std::int64_t{k} - position_);
      if (const std::int64_t columns = static_cast<std::int64_t>(column) - last_column_; !here.seen && columns > 0) {
        const std::int64_t step = floored(kParts * wrapped(std::int64_t{position_} - last_position_), columns);
        mean_step_ = has_step_ ? mean_step_ + floored(step - mean_step_, kSlowness) : step;
        has_step_ = true;
      }
      here = {position_, kind, true};
      last_position_ = position_;
      last_column_ = static_cast<std::int64_t>(column);
    } else if (!of.seen) {
      last_ = k;
    }
    of = {k, static_cast<std::uint32_t>(column), kind, true};
    return k;
  }

  std::int32_t wrapped(std::int64_t steps) const {
    const std::int64_t least = -(turn_ / 2), most = least + turn_ - 1;
    if (steps < least) steps += turn_;
    if (steps > most) steps -= turn_;
    if (steps < least || steps > most) [[unlikely]] {
      steps = (steps - least) % turn_;
      steps += steps < 0 ? turn_ + least : least;
    }
    return static_cast<std::int32_t>(steps);
  }

 private:
  struct Row {
    std::int32_t k = 0;
    std::uint32_t column = 0;
    std::uint8_t left = 0;
    bool seen = false;
  };
  struct Column {
    std::int32_t position = 0;
    std::uint8_t left = 0;
    bool seen = false;
  };

  static constexpr std::int64_t kParts = 256, kSlowness = 8;

  static std::int64_t floored(std::int64_t a, std::int64_t b) { return a >= 0 ? a / b : -((b - 1 - a) / b); }
  // Steps of so many columns, as they mostly are.
  std::int64_t stepped(std::int64_t columns) const { return floored(mean_step_ * columns + kParts / 2, kParts); }

  DirectionForm form_;
  std::int64_t turn_;
  std::int32_t step_;
  std::vector<Row> rows_;
  std::vector<Column> columns_;
  std::int32_t last_ = 0;  // ByColumn: direction of the first point of the last row that began, less its column's
  std::int32_t position_ = 0, last_position_ = 0;
  std::int64_t last_column_ = 0, mean_step_ = 0;  // in parts of a step
  bool has_step_ = false;
};

}  // namespace lidarcodec
