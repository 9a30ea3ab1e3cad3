// The returns of a frame as a list of points, in whole numbers: the input of reducers.
#pragma once
#include <cstddef>
#include <cstdint>
#include <vector>

#include "motion/beams.hpp"
#include "motion/range_history.hpp"

namespace lidarcodec {

// In range-image order: row 0 from the first to the last column, then row 1, and so on.
struct Returns {
  std::vector<std::int32_t> xyz;    // (N, 3), 1/16 mm: forward, left, up
  std::vector<std::uint32_t> cell;  // (N,), row * W + column
};

// ranges: (64, W), steps of 2 mm, 0 = no return. Every return has a point; a beam steeper than 75 degrees points
// straight up or down. Raises Section if an azimuth is out of range.
Returns returns_of(const std::uint16_t* ranges, const Columns& columns, const BeamTable& table);

// How cheap returns are to send.
struct Lattice {
  std::vector<std::uint32_t> order;  // (N,), places in the list, by rising level, then in range-image order
  std::vector<std::uint8_t> level;   // (N,), 0 to 27: kRowLevels times the level of the direction, plus that of the row
};

// cell: (N,) = `count`, each below 64 * W, rising. Raises Section otherwise.
Lattice lattice_of(const std::uint32_t* cell, std::size_t count, const Columns& columns, const BeamTable& table);

}  // namespace lidarcodec
