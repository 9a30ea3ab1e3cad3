// Values for cells without a return, chosen so that they cost an image codec least. What they are is never decoded.
#pragma once
#include <array>
#include <cstddef>
#include <cstdint>
#include <vector>

namespace lidarcodec {

using StepTable = std::array<std::uint16_t, 64>;

// For a codec of 8 x 8 cosine blocks. Samples, rows x width, both multiples of 8, with the holes (known = 0) filled:
// first by straight lines along each row; then, in blocks that have both, `rounds` times by what is left of the block
// when coefficients that its steps would quantise to nothing are dropped. Blocks of nothing but holes repeat the mean
// of the block to their left. Rows without any known sample take the row above.
// Throws Error(Settings) for sizes that are no multiples of 8.
std::vector<float> fill_blocks(const float* samples, const std::uint8_t* known, std::size_t rows, std::size_t width,
                               const StepTable& steps, unsigned rounds);

// For codecs that predict from left, above and above left. In place: each hole takes the clamped gradient
// left + above - above left of the image so filled.
void fill_predicted(std::uint16_t* values, const std::uint8_t* known, std::size_t rows, std::size_t width);

}  // namespace lidarcodec
