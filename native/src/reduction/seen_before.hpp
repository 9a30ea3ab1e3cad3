// Which returns lie on nothing that the sensor saw in scans of its own a while ago: what moves, mostly.
//
// Ground is told apart and let be: the rings on it move with the vehicle, so it is not seen again at the same places.
#pragma once
#include <array>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "motion/beams.hpp"
#include "motion/range_history.hpp"

namespace lidarcodec {

// Points in metres in the frame of the sensor at the start of a scan, as if all of it had been seen then.
struct Scan {
  const float* xyz = nullptr;  // (N, 3)
  std::size_t size = 0;
};

// Where the sensor of a past scan was, seen from the one of now: rotation, row by row, each with its part of the shift.
using Placed = std::array<float, 12>;

// xyz: (N, 3), 1/16 mm; cell: (N,), each below 64 * W; moved: (W, 12), how the points of each column are to be moved.
// (N, 3), metres. Raises Section if a cell is out of range.
std::vector<float> deskewed(const std::int32_t* xyz, const std::uint32_t* cell, std::size_t size, const float* moved,
                            std::size_t width);

// 1 for each return that lies on the ground, or so low above it that it may; (N,). Ground is what goes on outwards from
// the vehicle without a step, in each of 128 directions.
// cell: (N,), rising. Raises Section if it does not, or if an azimuth is out of range.
std::vector<std::uint8_t> ground_of(const Scan& scan, const std::uint32_t* cell, const Columns& columns,
                                    const BeamTable& table);

struct PastScan {
  Scan scan;
  Placed placed;
};

// 1 for each return nearer than 40 m, not on the ground, from which no return of any past scan lies within 0.25 m and
// 0.8 % of its range; (N,).
std::vector<std::uint8_t> unseen(const Scan& scan, const std::uint8_t* ground, const std::vector<PastScan>& past);

}  // namespace lidarcodec
