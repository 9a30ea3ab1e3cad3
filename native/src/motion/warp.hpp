// The ranges that a frame is expected to have: what was last seen in each direction, moved as the sensor moved.
// In whole numbers only; the rules are docs/wire-format-motion.md.
#pragma once
#include <cstdint>
#include <vector>

#include "motion/beams.hpp"
#include "motion/range_history.hpp"

namespace lidarcodec {

// (64, W), range steps, 0 where nothing is known. Takes 4 MiB and 7 ms for a frame of a turn. Raises Section if
// an azimuth is out of range.
std::vector<std::uint16_t> expected_ranges(const RangeHistory& history, const BeamTable& table, const Motion& motion,
                                           const Columns& columns);

}  // namespace lidarcodec
