// Values for cells without a return that cost an image codec few bits. The decoder discards them.
#pragma once
#include <array>
#include <cstddef>
#include <cstdint>
#include <vector>

namespace lidarcodec {

using StepTable = std::array<std::uint16_t, 64>;  // of the coefficients of a block, row by row

// For a codec of 8 x 8 DCT blocks. Gives samples, rows x width, both multiples of 8, with the holes (known = 0) filled.
// Holes are first interpolated along each row. Then, in blocks with samples and holes, `rounds` projections follow:
// coefficients that the quantiser would set to 0 are dropped, and the holes move towards the result (as in the method
// of convex projections: Youla and Webb 1982). Blocks of holes alone repeat the mean of the block to their left. Rows
// without samples repeat the row above. Throws Error(Settings) for sizes that are not multiples of 8.
std::vector<float> fill_blocks(const float* samples, const std::uint8_t* known, std::size_t rows, std::size_t width,
                               const StepTable& steps, unsigned rounds);

// For codecs that predict from the left, above and above left. In place: each hole gets the clamped gradient left +
// above - above left of the image filled so far.
void fill_predicted(std::uint16_t* values, const std::uint8_t* known, std::size_t rows, std::size_t width);

}  // namespace lidarcodec
