// Coder of the planes of frames that follow each other: what it learned goes on, and the frame before says what to
// expect. docs/wire-format-planes.md has the format.
#pragma once
#include <cstddef>
#include <cstdint>
#include <vector>

#include "images/memory.hpp"

namespace lidarcodec {

// Bytes of all planes of the next frame. runs: where its columns look in the frame before; none: that is not looked at.
// Raises Settings if the frame, an image, a value or a run does not fit.
std::vector<std::uint8_t> encode_next_planes(PlaneMemory& memory, const PlaneFrame& frame,
                                             const std::vector<PlaneImage>& images, const std::vector<ColumnRun>& runs);

// The images of the next frame. Raises Settings if the frame is beyond its limits, Section or Truncated if the bytes
// are damaged.
std::vector<PlaneImage> decode_next_planes(PlaneMemory& memory, const std::uint8_t* data, std::size_t size,
                                           const PlaneFrame& frame);

}  // namespace lidarcodec
