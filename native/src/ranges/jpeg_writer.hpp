// A JPEG of one component (ITU-T T.81, sequential, Huffman), 8 or 12 bits a sample, with any quantisation table.
//
// The usual tables are for the eye, which tolerates errors of high frequencies. For the least mean squared error all
// coefficients have the same step, which saves 20 % of the bits.
#pragma once
#include <cstddef>
#include <cstdint>
#include <vector>

#include "ranges/holes.hpp"

namespace lidarcodec {

// Gives the file. samples: rows x width, 0 to 2^bits - 1, not rounded; both sides multiples of 8 and at most 65528.
// steps: of each coefficient, 1 or more, row by row. Huffman tables are optimised for the image.
// Throws Error(Settings) for sizes, bits or steps that a JPEG cannot have.
std::vector<std::uint8_t> write_jpeg(const float* samples, std::size_t rows, std::size_t width, unsigned bits,
                                     const StepTable& steps);

}  // namespace lidarcodec
