// Ranges of a frame that are a picture for itself: jxl of an HDL-64E, and jpeg.
#pragma once
#include "session/frames/image_frame.hpp"
#include "session/planes.hpp"

namespace lidarcodec {

// Puts the ranges of a message of jxl or jpeg into the planes of a frame of an HDL-64E. Raises Section.
void put_still_ranges(const Message& message, const Outside& outside, const Sensor& sensor, Planes& planes);

// The same of jpeg of another sensor, whose frame has planes. Raises Section or Truncated.
void put_still_ranges(const Message& message, const Outside& outside, ImageFrame& frame);

}  // namespace lidarcodec
