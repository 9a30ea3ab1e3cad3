// Coder of keep masks: which returns of a reduced frame are sent. They are few, on a lattice of directions, and not
// next to each other. So the contexts are the distance to the last kept cell, and what the rows above and the mask of a
// turn ago kept around the direction. docs/wire-format-keep.md has the format.
#pragma once
#include <cstddef>
#include <cstdint>
#include <vector>

#include "mask/coder.hpp"

namespace lidarcodec {

// keep: (64, W); azimuth: (2, W), 0 to 35999; earlier: the mask last sent in the direction of each cell, as wide
// as the mask, or of width 0. Raises Section if shapes do not fit, an azimuth is out of range, or a cell is set in a
// block that did not fire.
std::vector<std::uint8_t> encode_keep(const std::uint8_t* keep, const MaskGeometry& geometry,
                                      const std::uint16_t* azimuth, EarlierMask earlier);

// (64, W) of 0 and 1, from a section of kind 4 or 5. Raises Section or Truncated.
std::vector<std::uint8_t> decode_keep(const std::uint8_t* data, std::size_t size, const MaskGeometry& geometry,
                                      const std::uint16_t* azimuth, EarlierMask earlier);

}  // namespace lidarcodec
