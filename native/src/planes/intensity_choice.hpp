// Intensities reduced to few values: which values, and which of them each return becomes, chosen for the frame at hand.
//
// What counts is the error for the bits that a coder will take, so a return becomes the nearest value only where that is
// worth its price: noise across the edge of two values costs nothing. Any decoder of intensities reads the result.
#pragma once
#include <cstddef>
#include <cstdint>
#include <vector>

#include "mask/coder.hpp"

namespace lidarcodec {

// (64, W), 0 outside of the returns: at most `levels` values, 2 to 255; intensities stay as they are where they have no more.
// Values and returns are (64, W). Raises Section if a cell is set in a block that did not fire.
std::vector<std::uint8_t> choose_levels(const std::uint8_t* values, const std::uint8_t* returns, const MaskGeometry& geometry,
                                        std::size_t levels);

}  // namespace lidarcodec
