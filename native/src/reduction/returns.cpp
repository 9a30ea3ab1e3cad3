#include "reduction/returns.hpp"

#include <array>
#include <utility>

#include "base/error.hpp"
#include "motion/directions.hpp"

namespace lidarcodec {

Returns returns_of(const std::uint16_t* ranges, const Columns& columns, const BeamTable& table) {
  check_azimuths(columns);
  const std::size_t width = columns.width;
  std::vector<CosSin> at(2 * width);
  for (std::size_t i = 0; i < 2 * width; ++i) {
    const bool as_upper = i >= width && columns.azimuth[i] == columns.azimuth[i - width];
    at[i] = as_upper ? at[i - width] : cos_sin(angle_of_azimuth(columns.azimuth[i]));
  }
  std::size_t count = 0;
  for (std::size_t i = 0; i < kRows * width; ++i) count += ranges[i] != 0;
  Returns returns;
  returns.xyz.resize(3 * count);
  returns.cell.resize(count);
  const Beams beams = beams_of(table);
  std::size_t n = 0;
  for (std::size_t row = 0; row < kRows; ++row) {
    const Beam& beam = beams[row];
    const CosSin* turn = at.data() + (table.half[row] ? width : 0);
    const std::uint16_t* range = ranges + row * width;
    const std::int64_t upwards = table.vertical[row] < 0 ? -1 : 1;
    for (std::size_t column = 0; column < width; ++column) {
      if (range[column] == 0) continue;
      const std::int64_t length = range[column] * kLengthsPerStep + beam.distance_correction;
      const Point p = beam.usable ? beam.point(length, turn[column]) : Point{0, 0, upwards * length};
      returns.xyz[3 * n] = static_cast<std::int32_t>(p.x);
      returns.xyz[3 * n + 1] = static_cast<std::int32_t>(p.y);
      returns.xyz[3 * n + 2] = static_cast<std::int32_t>(p.z);
      returns.cell[n++] = static_cast<std::uint32_t>(row * width + column);
    }
  }
  return returns;
}

Lattice lattice_of(const std::uint32_t* cell, std::size_t count, const Columns& columns, const BeamTable& table) {
  check_azimuths(columns);
  const std::size_t width = columns.width;
  constexpr std::size_t kLevels = kDirectionLevels * kRowLevels;
  std::vector<std::uint8_t> level(count);
  std::array<std::uint32_t, kLevels + 1> begin{};
  std::vector<std::uint8_t> of_column(width);
  std::size_t n = 0;
  for (std::size_t row = 0; row < kRows && n < count; ++row) {
    const std::size_t end = (row + 1) * width;
    if (cell[n] >= end) continue;
    const std::uint16_t* azimuth = columns.azimuth + (table.half[row] ? width : 0);
    const std::uint32_t aside = direction_offset(table.rotation[row]);
    std::uint32_t before = kDirections;
    for (std::size_t column = 0; column < width; ++column) {
      const std::uint32_t direction = direction_of(azimuth[column], aside);
      of_column[column] =
          static_cast<std::uint8_t>(direction == before ? kSharedDirection : direction_level(direction));
      before = direction;
    }
    for (; n < count && cell[n] < end; ++n) {
      if (n > 0 && cell[n] <= cell[n - 1]) throw Error(ErrorCode::Section, "the cells of returns do not rise");
      level[n] = static_cast<std::uint8_t>(of_column[cell[n] - row * width] * kRowLevels + row_level(row));
      ++begin[level[n] + 1u];
    }
  }
  if (n < count) throw Error(ErrorCode::Section, "a return in a cell beyond the frame");
  for (std::size_t i = 0; i < kLevels; ++i) begin[i + 1] += begin[i];
  std::vector<std::uint32_t> order(count);
  for (std::size_t i = 0; i < count; ++i) order[begin[level[i]]++] = static_cast<std::uint32_t>(i);
  return {std::move(order), std::move(level)};
}

}  // namespace lidarcodec
