// Coder of the planes of frames that follow each other: what it learned goes on, and the frame before says what to
// expect. docs/wire-format-planes.md has the format.
#pragma once
#include <cstddef>
#include <cstdint>
#include <vector>

#include "images/memory.hpp"

namespace lidarcodec {

// Where a sensor looks, so that frames can be moved as it moves. azimuth: of each column, 0.01 degree, clockwise;
// metre: ranges in a metre. Without beams nothing is moved.
struct SensorView {
  PlaneBeams beams;
  std::vector<std::uint16_t> azimuth;
  double metre = 0;
};

// Bytes of all planes of the next frame. runs: where its columns look in the frame before; none: that is not looked at.
// Raises Settings if the frame, an image, a value, a run or the view does not fit.
std::vector<std::uint8_t> encode_next_planes(PlaneMemory& memory, const PlaneFrame& frame,
                                             const std::vector<PlaneImage>& images, const std::vector<ColumnRun>& runs,
                                             const SensorView& view = {});

// The images of the next frame. Raises Settings if the frame is beyond its limits, Section or Truncated if the bytes
// are damaged.
std::vector<PlaneImage> decode_next_planes(PlaneMemory& memory, const std::uint8_t* data, std::size_t size,
                                           const PlaneFrame& frame);

}  // namespace lidarcodec
