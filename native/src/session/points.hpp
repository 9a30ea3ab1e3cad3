// A frame's returns as points in metres; lidarcodec/cloud.py and lidarcodec/other_cloud.py say by which formulas.
#pragma once
#include <vector>

#include "session/frames/cloud.hpp"
#include "session/session.hpp"

namespace lidarcodec {

// Column by column, in a column from the top ring down. both: second returns too, after the first ones. Of an HDL-64E
// there are first returns only, and times are the frame's: others are in its side information, which is not looked
// into.
std::vector<CloudPoint> points_of(const SessionFrame& frame, bool both = false);

}  // namespace lidarcodec
