// The ranges that a frame is expected to have: the history, transformed by the motion and seen from the sensor's new
// position. In whole numbers only; the rules are in docs/wire-format-motion.md.
#pragma once
#include <cstdint>
#include <vector>

#include "motion/beams.hpp"
#include "motion/range_history.hpp"

namespace lidarcodec {

// (64, W), range steps, 0 where nothing is known. Takes 4 MiB, and 5 ms for a frame of a turn, 2 ms for a quarter of
// one. Raises Section if an azimuth is out of range.
std::vector<std::uint16_t> expected_ranges(const RangeHistory& history, const BeamTable& table, const Motion& motion,
                                           const Columns& columns);

}  // namespace lidarcodec
