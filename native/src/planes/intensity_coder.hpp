// Intensity coder: the intensities of the returns of a frame, by context mixing. docs/wire-format-intensity.md has the
// format.
//
// Rows are coded from the top. The two halves of a row are coded at the same time: each has a range coder, and both use
// the same models. So a core works on one half while the other waits for its decision.
#pragma once
#include <cstddef>
#include <cstdint>
#include <vector>

#include "mask/coder.hpp"

namespace lidarcodec {

// Intensities of the cells set in `returns`; both (64, W). `turn`: columns in a full turn, up to 65535; 0: it is
// found from the mask. Raises Section if a cell is set in a block that did not fire.
std::vector<std::uint8_t> encode_intensity(const std::uint8_t* values, const std::uint8_t* returns,
                                           const MaskGeometry& geometry, std::uint32_t turn = 0);

// (64, W), 0 outside of `returns`. Raises Section or Truncated.
std::vector<std::uint8_t> decode_intensity(const std::uint8_t* data, std::size_t size, const std::uint8_t* returns,
                                           const MaskGeometry& geometry);

}  // namespace lidarcodec
