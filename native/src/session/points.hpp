// A frame's returns as points in metres; lidarcodec/cloud.py says by which formulas.
#pragma once
#include <cstdint>
#include <vector>

#include "session/session.hpp"

namespace lidarcodec {

struct CloudPoint {
  float x, y, z;  // metres: forward, left, up
  std::uint8_t intensity, laser, ring;
};

// Column by column, in a column from the top ring down.
std::vector<CloudPoint> points_of(const SessionFrame& frame);

}  // namespace lidarcodec
