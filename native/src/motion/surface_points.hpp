// Points of a frame that lie on planes, with their normals: what a frame is registered by.
#pragma once
#include <vector>

#include "motion/vectors.hpp"
#include "motion/views.hpp"

namespace lidarcodec {

struct SurfacePoint {
  Vector3 at, normal;  // the normal points towards the sensor
};

// At most one point in a voxel of 0.4 m, and at most 500 for each of five classes of normals, so that the points bind
// the motion in all directions.
std::vector<SurfacePoint> surface_points(const View& view);

}  // namespace lidarcodec
