// Azimuth coder: the azimuth of each block of a frame, and which blocks fired. docs/wire-format-sections.md has the
// format.
//
// A sensor rotates evenly, but its azimuth has coarse steps. So the differences have few values, in an order that
// almost repeats (KITTI: a 9 after six or seven 18s). The most frequent differences get a number. Whether the most
// frequent one follows is predicted from the lengths of its last runs. A second block with the same azimuth costs
// almost nothing.
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

// Columns in a full turn, from the mean difference of these azimuths without gaps. 0 if the sensor does not rotate.
std::uint32_t columns_in_turn(const std::uint16_t* rotations, std::size_t count);

}  // namespace lidarcodec
