// Azimuth coder: the rotation of each block of a frame, and which blocks fired. The format is
// docs/wire-format-sections.md, section "azimuth".
//
// A sensor turns evenly and counts coarsely: its steps are two values whose order nearly repeats (KITTI: one 9 after
// six or seven 18s). The most frequent steps get a number; "again the most frequent" is told by the lengths of the last
// runs of it. A second block at the same rotation costs next to nothing.
#pragma once
#include <cstddef>
#include <cstdint>
#include <vector>

namespace lidarcodec {

struct Azimuths {
  std::vector<std::uint16_t> azimuth;  // (2, W): upper, lower; 0.01 degree, 0 to 35999
  std::vector<std::uint8_t> fired;     // (2, W)
};

// Raises Section if a value is over 35999, or a half that did not fire does not repeat the other.
std::vector<std::uint8_t> encode_azimuth(const std::uint16_t* azimuth, const std::uint8_t* fired, std::size_t width);

// Raises Section or Truncated.
Azimuths decode_azimuth(const std::uint8_t* data, std::size_t size, std::size_t width);

// Columns in a full turn at the mean step of so many rotations; gaps are left out. 0 if the sensor does not turn.
std::uint32_t columns_in_turn(const std::uint16_t* rotations, std::size_t count);

}  // namespace lidarcodec
