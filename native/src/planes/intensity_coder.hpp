// Intensity coder: the intensities of the returns of a frame, by context mixing. docs/wire-format-intensity.md has the
// format.
//
// Rows are coded from the top. The two halves of a row are coded at the same time: each has a range coder, and both use
// the same models. So a core works on one half while the other waits for its decision.
//
// The parts of a turn share models: each part goes on from what those before it taught (IntensityMemory). So do the
// frames of a stream, in codecs whose frames refer to earlier ones.
#pragma once
#include <array>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "bits/cells.hpp"
#include "mask/coder.hpp"
#include "planes/intensity_symbols.hpp"
#include "planes/intensity_turn.hpp"

namespace lidarcodec {

// What sections taught. Without models (`cells` empty) the next one begins anew.
struct IntensityMemory {
  bool follows = false;  // whether frames go on from each other, beside the parts of a turn
  Symbols symbols;
  std::vector<Cells> cells;
  std::array<std::array<std::uint8_t, 4>, kMaskRows> last{};  // symbols at the end of each row, the latest first
  std::array<bool, kMaskRows> ended{};                        // whether a row has had a return
  IntensityTurn turn;                                         // of frames that go on from each other
  // Of encoders alone: the returns since models began, and which values the stream has had.
  std::size_t returns = 0;
  std::array<bool, 256> seen{};
};

// Forgets the models: the next section begins anew.
void forget_models(IntensityMemory& memory);

// Intensities of the cells set in `returns`; both (64, W). `turn`: columns in a full turn, up to 65535; 0: it is
// found from the mask. memory: what to go on from, which this section does unless a value is new; changed. azimuth:
// (2, W), 0 to 35999, of a memory that follows frames. Raises Section if a cell is set in a block that did not fire.
std::vector<std::uint8_t> encode_intensity(const std::uint8_t* values, const std::uint8_t* returns,
                                           const MaskGeometry& geometry, std::uint32_t turn = 0,
                                           IntensityMemory* memory = nullptr, const std::uint16_t* azimuth = nullptr);

// (64, W), 0 outside of `returns`. memory, azimuth: as above; without them a section that needs them is damage. Raises
// Section or Truncated.
std::vector<std::uint8_t> decode_intensity(const std::uint8_t* data, std::size_t size, const std::uint8_t* returns,
                                           const MaskGeometry& geometry, IntensityMemory* memory = nullptr,
                                           const std::uint16_t* azimuth = nullptr);

}  // namespace lidarcodec
