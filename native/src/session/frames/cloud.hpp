// Points of a frame of another sensor than an HDL-64E; in Python lidarcodec/other_cloud.py.
#pragma once
#include "session/frames/image_frame.hpp"

namespace lidarcodec {

// A return. x forward, y left, z up, in metres; intensity and laser as the sensor has them; ring: the row, 0 at the
// top; cell: its place in each plane, row * W + column, or in a point cloud among the points of the message;
// return_number: 1, or 2 of a second return; t_ns: host time of the packet plus the time from its own stamp to the
// firing, since 1970 UTC.
struct CloudPoint {
  float x, y, z;
  std::uint32_t intensity, cell;
  std::uint8_t laser, ring, return_number;
  std::int64_t t_ns;
};

// First returns column by column, each from the top ring down; with `both`, then the second ones in the same order,
// those left out that are the first one sent again. None where the directions of beams are not known. Of a point cloud
// in the order of the message.
std::vector<CloudPoint> cloud_of(const ImageFrame& frame, std::int64_t stamp_ns, bool both);

}  // namespace lidarcodec
