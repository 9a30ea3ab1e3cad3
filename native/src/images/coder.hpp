// Coder of the planes of one frame. docs/wire-format-planes.md has the format; README.md in this folder says why.
#pragma once
#include <cstddef>
#include <cstdint>
#include <vector>

#include "images/forms.hpp"

namespace lidarcodec {

// Bytes of all planes; quick: in half the time, a tenth more of them. images: one of frame.planes each. Raises Settings
// if the frame, an image or a value does not fit.
std::vector<std::uint8_t> encode_planes(const PlaneFrame& frame, const std::vector<PlaneImage>& images,
                                        bool quick = false);

// The images of all planes; ranges are at most (step - 1) / 2 off. Raises Settings if the frame is beyond its limits,
// Section or Truncated if the bytes are damaged.
std::vector<PlaneImage> decode_planes(const std::uint8_t* data, std::size_t size, const PlaneFrame& frame);

}  // namespace lidarcodec
