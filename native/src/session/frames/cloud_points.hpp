// Points of a cloud that came as a message, in Python lidarcodec/sensors/clouds/points.py.
#pragma once
#include "session/frames/cloud.hpp"
#include "session/frames/cloud_section.hpp"

namespace lidarcodec {

// The field of the intensities of points: `intensity`, else `reflectivity` or `i`; nullptr if there is none.
const CloudField* intensity_field(const CloudPoints& points);

// How many points `points_of_cloud` gives.
std::size_t returns_of_cloud(const CloudPoints& points);

// Those with a return, in the order of the message; `cell` is the place of a point there. rows: of the sensor.
std::vector<CloudPoint> points_of_cloud(const DecodedCloud& cloud, std::size_t rows, std::int64_t stamp_ns);

}  // namespace lidarcodec
