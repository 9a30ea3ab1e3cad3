// Geometry of another sensor than an HDL-64E as a calibration of each ring, for viewers that compute points themselves:
// lidarcodec_server/live/ring_geometry.py says how it is fitted.
#pragma once
#include "session/frames/image_frame.hpp"

namespace lidarcodec {

// Radians and metres.
struct RingGeometry {
  double rotation = 0, elevation = 0, distance = 0, height = 0, aside = 0;
};

// Of each row; zeros for a frame whose points are not known.
std::vector<RingGeometry> ring_geometry(const ImageFrame& frame);

// Range steps of the sensor that are one step of a range image in 16 bits.
std::uint32_t shown_step(const ImageFrame& frame);

// (H, W) ranges in steps of `shown_step`; a return stays one.
std::vector<std::uint16_t> shown_ranges(const ImageFrame& frame);

// (H, W) intensities, larger ones than 255 as 255; empty if the frame has none.
std::vector<std::uint8_t> shown_intensities(const ImageFrame& frame);

}  // namespace lidarcodec
