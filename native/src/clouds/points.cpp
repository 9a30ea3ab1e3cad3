#include "clouds/points.hpp"

#include <algorithm>
#include <bit>
#include <cstring>

namespace lidarcodec {
namespace {

constexpr std::size_t kBlock = 512;  // points that are written together, so that they stay in the cache

template <std::size_t kBytes>
void put_values(const std::uint8_t* from, std::size_t count, std::size_t step, bool turned, std::uint8_t* out) {
  for (std::size_t i = 0; i < count; ++i, from += kBytes, out += step) {
    if (turned)
      std::reverse_copy(from, from + kBytes, out);
    else
      std::memcpy(out, from, kBytes);
  }
}

}  // namespace

void put_fields(std::span<const PointField> fields, std::size_t points, std::size_t step, bool big_endian,
                std::uint8_t* out) {
  const bool turned = big_endian == (std::endian::native == std::endian::little);
  for (std::size_t begin = 0; begin < points; begin += kBlock) {
    const std::size_t count = std::min(kBlock, points - begin);
    for (const PointField& field : fields) {
      const std::uint8_t* const from = field.values + begin * field.bytes;
      std::uint8_t* const to = out + begin * step + field.at;
      if (field.bytes == 1) put_values<1>(from, count, step, false, to);
      if (field.bytes == 2) put_values<2>(from, count, step, turned, to);
      if (field.bytes == 4) put_values<4>(from, count, step, turned, to);
      if (field.bytes == 8) put_values<8>(from, count, step, turned, to);
    }
  }
}

PointCells cells_of_points(const PointOrder& order) {
  PointCells cells;
  const std::size_t most = order.rows * order.columns;
  cells.row.reserve(most);
  cells.column.reserve(most);
  const auto take = [&](std::size_t row, std::size_t column) {
    if (!order.ranges.empty() && order.ranges[row * order.columns + column] == 0) return;
    cells.row.push_back(static_cast<std::int64_t>(row));
    cells.column.push_back(static_cast<std::int64_t>(column));
  };
  if (!order.by_column) {
    for (std::size_t row = 0; row < order.rows; ++row)
      for (std::size_t column = 0; column < order.columns; ++column) take(row, column);
    return cells;
  }
  for (std::size_t column = 0; column < order.columns; ++column)
    for (const std::int64_t row : order.firing) take(static_cast<std::size_t>(row), column);
  return cells;
}

}  // namespace lidarcodec
