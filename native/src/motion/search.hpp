// How a sensor moved in a turn, found from what it saw: points of the current frame with their normals against the surface
// that the history holds (point-to-plane ICP with projective association). For encoders only: a decoder is told the motion.
// Floating point, but only + - * / and square roots: the same numbers on every IEEE machine without contraction.
#pragma once
#include <cstdint>

#include "motion/beams.hpp"
#include "motion/range_history.hpp"

namespace lidarcodec {

struct FoundMotion {
  Motion motion;                  // the start if nothing was found
  bool found = false;
  std::uint32_t points = 0;       // points with a normal that were tried
  std::uint32_t matched = 0;      // of them, those that lie on the history's surface
  std::uint32_t iterations = 0;
  double median_m = 0;            // median distance of the matched ones from it
};

// Motion from a turn ago to the frame with these ranges, (64, W), searched from `start`. Takes 6 ms for a frame of a turn.
// hold: it is close to the start, as for a slab, which does not hold a motion firmly by itself.
// Raises Section if an azimuth is out of range.
FoundMotion find_motion(const RangeHistory& history, const std::uint16_t* ranges, const Columns& columns,
                        const BeamTable& table, const Motion& start, bool hold = false);

}  // namespace lidarcodec
