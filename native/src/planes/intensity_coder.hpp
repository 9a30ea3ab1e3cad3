// Intensity coder: the intensities of the returns of a frame, by context mixing. docs/wire-format-intensity.md has the
// format.
//
// Rows are coded from the top. The two halves of a row are coded at the same time: each has a range coder, and both use
// the same models. So a core works on one half while the other waits for its decision.
//
// The parts of a turn share models: each part goes on from what those before it taught (IntensityMemory).
#pragma once
#include <array>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "bits/cells.hpp"
#include "mask/coder.hpp"
#include "planes/intensity_symbols.hpp"

namespace lidarcodec {

// What the parts of a turn taught. Without models (`cells` empty) the next part begins anew.
struct IntensityMemory {
  Symbols symbols;
  std::vector<Cells> cells;
  std::array<std::array<std::uint8_t, 4>, kMaskRows> last{};  // symbols at the end of each row, the latest first
  std::array<bool, kMaskRows> ended{};                        // whether a row has had a return
  // Of encoders alone: the returns of the turn so far, and which values the stream has had.
  std::size_t returns = 0;
  std::array<bool, 256> seen{};
};

// Forgets the parts before: a turn begins.
void begin_turn(IntensityMemory& memory);

// Intensities of the cells set in `returns`; both (64, W). `turn`: columns in a full turn, up to 65535; 0: it is
// found from the mask. memory: of a turn in parts; goes_on: whether this part goes on from those before it, which it
// does unless a value is new. Raises Section if a cell is set in a block that did not fire.
std::vector<std::uint8_t> encode_intensity(const std::uint8_t* values, const std::uint8_t* returns,
                                           const MaskGeometry& geometry, std::uint32_t turn = 0,
                                           IntensityMemory* memory = nullptr, bool goes_on = false);

// (64, W), 0 outside of `returns`. memory: of a turn in parts, what the parts before taught. Raises Section or
// Truncated.
std::vector<std::uint8_t> decode_intensity(const std::uint8_t* data, std::size_t size, const std::uint8_t* returns,
                                           const MaskGeometry& geometry, IntensityMemory* memory = nullptr);

}  // namespace lidarcodec
