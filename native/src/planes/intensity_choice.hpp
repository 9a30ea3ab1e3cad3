// Quantisation of a frame's intensities to few levels: the levels, and the level of each return.
//
// The choice minimises error plus lambda times bits (entropy-constrained quantisation: Chou, Lookabaugh and Gray 1989).
// So a return gets its nearest level only if that is worth its bits: noise at the border of two levels costs nothing.
// Any decoder of intensities reads the result.
#pragma once
#include <cstddef>
#include <cstdint>
#include <vector>

#include "mask/coder.hpp"

namespace lidarcodec {

// (64, W), 0 outside of the returns: at most `levels` values, 2 to 255. Intensities with no more values stay as they
// are. Values and returns are (64, W). Raises Section if a cell is set in a block that did not fire.
std::vector<std::uint8_t> choose_levels(const std::uint8_t* values, const std::uint8_t* returns,
                                        const MaskGeometry& geometry, std::size_t levels);

}  // namespace lidarcodec
