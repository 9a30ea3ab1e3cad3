// Fields of the points of a cloud beside x, y and z, and the columns of a range image that the points come in.
#pragma once
#include "clouds/positions.hpp"

namespace lidarcodec {

// Rests of a field, (N,) kMostRest at most, each in the context of those of its row and its column before it.
std::vector<std::uint8_t> encode_field_rests(const CloudCells& cells, std::span<const std::uint32_t> rests);

// The inverse. Raises Section or Truncated.
std::vector<std::uint32_t> decode_field_rests(Bytes data, const CloudCells& cells);

// A field whose values are sums: a number of the column, (W,), and one of the row, (H,), and what is left.
struct FieldSums {
  std::vector<std::int64_t> by_column;
  std::vector<std::uint8_t> left;  // coded
  std::size_t not_told = 0;        // points of which something is left
};

// Of whole numbers less than 2^61 in magnitude; nothing if too much is left.
std::optional<FieldSums> sums_of(const CloudCells& cells, std::span<const std::int64_t> numbers,
                                 std::span<const std::int64_t> by_row);

// Of times in seconds: the sums are in units of 1e-9, and what is left in units in the last place; nothing if too much
// is left, or a time is no number below 1e6.
std::optional<FieldSums> sums_of(const CloudCells& cells, std::span<const float> times,
                                 std::span<const std::int64_t> by_row);

// The inverses. Raise Section or Truncated.
std::vector<std::int64_t> numbers_of_sums(const CloudCells& cells, std::span<const std::int64_t> by_column,
                                          std::span<const std::int64_t> by_row, Bytes left);
std::vector<float> times_of_sums(const CloudCells& cells, std::span<const std::int64_t> by_column,
                                 std::span<const std::int64_t> by_row, Bytes left);

// How points of a cloud without rows come: column by column, the rings of each in an order.
struct FiringOrder {
  std::span<const std::int64_t> rank;  // place of each ring in it
  std::span<const double> turned;      // direction of each ring, radians
  double jump = 0;                     // radians: a point that is as far from the one before begins a column
};

// (N,) column of each point, ascending; in each the ranks of the rings ascend, too. Raises Section for rings beyond
// the order.
std::vector<std::int64_t> columns_of_firing(const FiringOrder& order, std::span<const std::int64_t> ring,
                                            std::span<const float> x, std::span<const float> y,
                                            std::span<const std::uint8_t> returned);

}  // namespace lidarcodec
