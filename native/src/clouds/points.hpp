// Points of a cloud as a message has them, one after the other, and as a range image has them.
#pragma once
#include <array>
#include <cstdint>
#include <span>
#include <vector>

namespace lidarcodec {

// A field of points: N values of so many bytes, in the machine's order, and its first byte in a point.
struct PointField {
  const std::uint8_t* values;
  std::size_t bytes, at;
};

// Writes the fields of `points` points of `step` bytes into `out`; other bytes stay as they are. big_endian: of values
// in the points. Fields lie within the step.
void put_fields(std::span<const PointField> fields, std::size_t points, std::size_t step, bool big_endian,
                std::uint8_t* out);

// Which cells of an image have a point, and the order of the points.
struct PointOrder {
  std::size_t rows = 0, columns = 0;
  bool by_column = false;                // column by column, the rows of each in the order of `firing`; else row by row
  std::span<const std::int64_t> firing;  // (H,), each row once
  std::span<const std::uint32_t> ranges;  // (H, W), above 0 where there is a point; empty if each cell has one
};

struct PointCells {
  std::vector<std::int64_t> row, column;
};

PointCells cells_of_points(const PointOrder& order);

// Values of an image, (H, W), in the order of the points.
template <class Number>
std::vector<std::uint32_t> at_points(const PointCells& cells, std::size_t columns, const Number* image) {
  std::vector<std::uint32_t> found(cells.row.size());
  for (std::size_t i = 0; i < found.size(); ++i)
    found[i] = image[static_cast<std::size_t>(cells.row[i]) * columns + static_cast<std::size_t>(cells.column[i])];
  return found;
}

}  // namespace lidarcodec
