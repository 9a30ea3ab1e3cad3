// Finds how a sensor moved between two frames of planes. Only encoders need it.
#pragma once
#include <cstdint>
#include <optional>
#include <vector>

#include "plane_motion/directions.hpp"
#include "plane_motion/motion.hpp"

namespace lidarcodec {

// Ranges of a frame in eighths, (rows, columns), 0: none, and where its columns look.
struct RangeView {
  const std::vector<std::int32_t>& eighths;
  const PlaneColumns& columns;
};

// The motion that brings surfaces of the frame before onto those of this one; nothing if they do not tell.
// metre: eighths of ranges in a metre; start: a motion to begin with, if one is known.
std::optional<PlaneMotion> find_motion(const PlaneBeams& beams, const RangeView& before, const RangeView& now,
                                       double metre, const std::optional<PlaneMotion>& start);

}  // namespace lidarcodec
