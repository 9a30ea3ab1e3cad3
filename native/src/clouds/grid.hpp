// The row of a range image for each point of a cloud whose message came without one; in Python
// lidarcodec/sensors/clouds/grid.py, which says how it is found.
#pragma once
#include "clouds/message.hpp"

namespace lidarcodec {

// Rows of a range image, and that of each point.
struct CloudRows {
  std::size_t rows = 0;
  std::vector<std::int64_t> row;
};

// x, y and z of the points of a message, and which of them are returns: finite, not all 0, and within 1,000 km.
struct CloudAxes {
  std::vector<double> x, y, z;  // 0 without a return
  std::vector<bool> returned;
};

// Nothing of a message without x, y and z as floating point numbers.
std::optional<CloudAxes> axes_of(const CloudPoints& points);

// The rows of a cloud; nothing if its points have no order.
std::optional<CloudRows> rows_of(const CloudPoints& points, const CloudAxes& axes);

}  // namespace lidarcodec
