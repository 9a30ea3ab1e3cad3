// Returns on surfaces that earlier scans of the same sensor did not see: mostly those on moving objects.
//
// Returns on the ground are left out. Their rings move with the vehicle, so they are never seen at the same place
// again.
#pragma once
#include <array>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "motion/beams.hpp"
#include "motion/range_history.hpp"

namespace lidarcodec {

// Deskewed points, in metres: in the frame that the sensor had at the start of the scan.
struct Scan {
  const float* xyz = nullptr;  // (N, 3)
  std::size_t size = 0;
};

// T_current_past: three rows of a rotation, each followed by its component of the translation.
using Placed = std::array<float, 12>;

// Gives (N, 3), metres. xyz: (N, 3), 1/16 mm; cell: (N,), each below 64 * W; moved: (W, 12), the transform of each
// column. Raises Section if a cell is out of range.
std::vector<float> deskewed(const std::int32_t* xyz, const std::uint32_t* cell, std::size_t size, const float* moved,
                            std::size_t width);

// (N,), 1 for each return on the ground, or less than 0.25 m above it. In each of 128 sectors the ground is the surface
// that goes on outwards from the vehicle without a step. cell: (N,), rising. Raises Section if it is not, or if an
// azimuth is out of range.
std::vector<std::uint8_t> ground_of(const Scan& scan, const std::uint32_t* cell, const Columns& columns,
                                    const BeamTable& table);

struct PastScan {
  Scan scan;
  Placed placed;
};

// (N,), 1 for each return that is nearer than 40 m, not on the ground, and further than 0.25 m plus 0.8 % of its range
// from all returns of the past scans.
std::vector<std::uint8_t> unseen(const Scan& scan, const std::uint8_t* ground, const std::vector<PastScan>& past);

}  // namespace lidarcodec
