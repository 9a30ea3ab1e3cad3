// How a sensor moved in a turn: the current frame is registered with what the history holds.
//
// Point-to-plane ICP (Chen and Medioni, "Object modelling by registration of multiple range images", 1992) with
// projective association (Blais and Levine, 1995): points of the current frame with their normals against the returns
// that the history has in the same directions. Only encoders do this; a decoder reads the motion from the message.
// Floating point, but only
// + - * / and square roots, so every IEEE machine without fused operations gets the same numbers.
#pragma once
#include <cstdint>

#include "motion/beams.hpp"
#include "motion/range_history.hpp"

namespace lidarcodec {

struct FoundMotion {
  Motion motion;  // the start if nothing was found
  bool found = false;
  std::uint32_t points = 0;   // points with a normal that were tried
  std::uint32_t matched = 0;  // of them, those that lie on the history's surface
  std::uint32_t iterations = 0;
  double median_m = 0;  // median of the absolute residuals of the matched points
};

// Motion from a turn ago to the frame with these ranges, (64, W), searched from `start`. Takes 6 ms for a frame of a
// turn. near_start: a prior holds the motion near `start`, for slabs, which see too little to determine it. Raises
// Section if an azimuth is out of range.
FoundMotion find_motion(const RangeHistory& history, const std::uint16_t* ranges, const Columns& columns,
                        const BeamTable& table, const Motion& start, bool near_start = false);

}  // namespace lidarcodec
