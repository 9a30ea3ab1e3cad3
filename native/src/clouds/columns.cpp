#include "clouds/columns.hpp"

#include <algorithm>
#include <cmath>
#include <numbers>

#include "clouds/rests.hpp"

namespace lidarcodec {
namespace {

// The rests of rows and columns before a point.
class Before {
 public:
  explicit Before(const CloudCells& cells) : cells_(cells), rows_(cells.rows), columns_(cells.columns) {}

  std::uint8_t context(std::size_t point) const {
    return static_cast<std::uint8_t>(4 * rows_[row(point)] + columns_[column(point)]);
  }
  void take(std::size_t point, std::uint32_t rest) {
    rows_[row(point)] = columns_[column(point)] = static_cast<std::uint8_t>(std::min(rest, 3u));
  }

 private:
  std::size_t row(std::size_t point) const { return static_cast<std::size_t>(cells_.row[point]); }
  std::size_t column(std::size_t point) const { return static_cast<std::size_t>(cells_.column[point]); }

  const CloudCells& cells_;
  std::vector<std::uint8_t> rows_, columns_;
};

constexpr double kTick = 1e-9;
constexpr float kLongestTime = 1e6F;

float time_of(std::int64_t ticks) { return static_cast<float>(static_cast<double>(ticks) * kTick); }

void check_sums(const CloudCells& cells, std::span<const std::int64_t> by_row) {
  check_cells(cells);
  if (by_row.size() != cells.rows) throw Error(ErrorCode::Section, "numbers that are not one for each row");
}

template <class Value, class Whole, class Left>
std::optional<FieldSums> summed(const CloudCells& cells, std::span<const Value> values,
                                std::span<const std::int64_t> by_row, const Whole& whole, const Left& left) {
  check_sums(cells, by_row);
  if (values.size() != cells.row.size()) throw Error(ErrorCode::Section, "values that are not one for each point");
  FieldSums found;
  found.by_column.resize(cells.columns);
  std::vector<bool> seen(cells.columns);
  const auto row = [&](std::size_t i) { return by_row[static_cast<std::size_t>(cells.row[i])]; };
  for (std::size_t i = 0; i < values.size(); ++i) {
    const auto column = static_cast<std::size_t>(cells.column[i]);
    if (seen[column]) continue;
    found.by_column[column] = whole(values[i]) - row(i);
    seen[column] = true;
  }
  for (std::size_t column = 1; column < cells.columns; ++column)
    if (!seen[column]) found.by_column[column] = found.by_column[column - 1];
  Before before(cells);
  RestWriter writer;
  writer.reserve(values.size());
  for (std::size_t i = 0; i < values.size(); ++i) {
    const std::int64_t rest = left(values[i], found.by_column[static_cast<std::size_t>(cells.column[i])] + row(i));
    const std::uint32_t number = zigzag(rest);
    if (number > kMostRest) return std::nullopt;
    writer.add(number, before.context(i));
    before.take(i, number);
    found.not_told += rest != 0;
  }
  found.left = writer.finish();
  return found;
}

template <class Value, class Sum>
std::vector<Value> told(const CloudCells& cells, std::span<const std::int64_t> by_column,
                        std::span<const std::int64_t> by_row, Bytes left, const Sum& sum) {
  check_sums(cells, by_row);
  if (by_column.size() != cells.columns) throw Error(ErrorCode::Section, "numbers that are not one for each column");
  Before before(cells);
  RestReader reader(left);
  std::vector<Value> values(cells.row.size());
  for (std::size_t i = 0; i < values.size(); ++i) {
    const std::uint32_t rest = reader.next(before.context(i));
    before.take(i, rest);
    values[i] =
        sum(by_column[static_cast<std::size_t>(cells.column[i])] + by_row[static_cast<std::size_t>(cells.row[i])],
            unzigzag(rest));
  }
  reader.finish();
  return values;
}

double wrapped(double angle) { return angle - nearest(angle / kFullTurn) * kFullTurn; }

}  // namespace

std::vector<std::uint8_t> encode_field_rests(const CloudCells& cells, std::span<const std::uint32_t> rests) {
  check_cells(cells);
  if (rests.size() != cells.row.size() ||
      std::any_of(rests.begin(), rests.end(), [](std::uint32_t rest) { return rest > kMostRest; }))
    throw Error(ErrorCode::Section, "rests that are too large, or not one for each point");
  Before before(cells);
  RestWriter writer;
  writer.reserve(rests.size());
  for (std::size_t i = 0; i < rests.size(); ++i) {
    writer.add(rests[i], before.context(i));
    before.take(i, rests[i]);
  }
  return writer.finish();
}

std::vector<std::uint32_t> decode_field_rests(Bytes data, const CloudCells& cells) {
  check_cells(cells);
  Before before(cells);
  RestReader reader(data);
  std::vector<std::uint32_t> rests(cells.row.size());
  for (std::size_t i = 0; i < rests.size(); ++i) {
    rests[i] = reader.next(before.context(i));
    before.take(i, rests[i]);
  }
  reader.finish();
  return rests;
}

std::optional<FieldSums> sums_of(const CloudCells& cells, std::span<const std::int64_t> numbers,
                                 std::span<const std::int64_t> by_row) {
  return summed(
      cells, numbers, by_row, [](std::int64_t number) { return number; },
      [](std::int64_t number, std::int64_t told) { return number - told; });
}

std::optional<FieldSums> sums_of(const CloudCells& cells, std::span<const float> times,
                                 std::span<const std::int64_t> by_row) {
  if (!std::all_of(times.begin(), times.end(), [](float time) { return std::abs(time) < kLongestTime; }))
    return std::nullopt;
  return summed(
      cells, times, by_row,
      [](float time) { return static_cast<std::int64_t>(nearest(static_cast<double>(time) / kTick)); },
      [](float time, std::int64_t told) { return ordered(time) - ordered(time_of(told)); });
}

std::vector<std::int64_t> numbers_of_sums(const CloudCells& cells, std::span<const std::int64_t> by_column,
                                          std::span<const std::int64_t> by_row, Bytes left) {
  return told<std::int64_t>(cells, by_column, by_row, left,
                            [](std::int64_t sum, std::int64_t rest) { return sum + rest; });
}

std::vector<float> times_of_sums(const CloudCells& cells, std::span<const std::int64_t> by_column,
                                 std::span<const std::int64_t> by_row, Bytes left) {
  return told<float>(cells, by_column, by_row, left,
                     [](std::int64_t sum, std::int64_t rest) { return from_ordered(ordered(time_of(sum)) + rest); });
}

std::vector<std::int64_t> columns_of_firing(const FiringOrder& order, std::span<const std::int64_t> ring,
                                            std::span<const float> x, std::span<const float> y,
                                            std::span<const std::uint8_t> returned) {
  const std::size_t points = ring.size(), rings = order.rank.size();
  if (x.size() != points || y.size() != points || returned.size() != points || order.turned.size() != rings ||
      std::any_of(ring.begin(), ring.end(),
                  [&](std::int64_t one) { return one < 0 || one >= static_cast<std::int64_t>(rings); }))
    throw Error(ErrorCode::Section, "rings that are not in the order of firing, or not one for each point");
  std::vector<std::int64_t> column(points);
  std::int64_t now = 0;
  double azimuth = 0, level = 0;
  std::int64_t rank = -1;
  for (std::size_t i = 0; i < points; ++i) {
    if (returned[i] != 0) azimuth = static_cast<double>(std::atan2(y[i], x[i]));
    const auto of = static_cast<std::size_t>(ring[i]);
    const double here = azimuth - order.turned[of];
    const bool anew = order.rank[of] <= rank, jumped = std::abs(wrapped(here - level)) > order.jump;
    if (i > 0 && (anew || jumped)) ++now;
    column[i] = now;
    rank = order.rank[of];
    level = here;
  }
  return column;
}

}  // namespace lidarcodec
