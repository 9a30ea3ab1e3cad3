// Intensity coder: the intensities of the returns of a frame, by adaptive models of their neighbours.
// The format is docs/wire-format-intensity.md.
//
// Rows are coded from the top. The two halves of a row are coded at the same time, each with a range coder of its own and
// both with the same models, so that a core has something to do while one of them waits for its next decision.
#pragma once
#include <cstddef>
#include <cstdint>
#include <vector>

#include "mask/coder.hpp"

namespace lidarcodec {

// Intensities of the cells set in `returns`; both (64, W). `turn`: columns in a full turn, up to 65535; 0: found from
// the mask. Raises Section if a cell is set in a block that did not fire.
std::vector<std::uint8_t> encode_intensity(const std::uint8_t* values, const std::uint8_t* returns,
                                           const MaskGeometry& geometry, std::uint32_t turn = 0);

// (64, W), 0 outside of `returns`. Raises Section or Truncated.
std::vector<std::uint8_t> decode_intensity(const std::uint8_t* data, std::size_t size, const std::uint8_t* returns,
                                           const MaskGeometry& geometry);

}  // namespace lidarcodec
