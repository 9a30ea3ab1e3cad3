// The geometry of an image out of a few numbers of a fuzzer's input.
#pragma once
#include <cstddef>
#include <cstdint>
#include <vector>

#include "mask/coder.hpp"

// Which halves of which columns fired, which half a row belongs to, and how far it is turned.
struct FuzzGeometry {
  std::vector<std::uint8_t> fired;
  lidarcodec::MaskGeometry image;

  // pattern: of eight columns, 0: all of them;  turned: how much from row to row;  mixed: halves are not upper and
  // lower
  FuzzGeometry(std::size_t width, std::uint8_t pattern, std::uint8_t turned, bool mixed) : fired(2 * width) {
    for (std::size_t i = 0; i < fired.size(); ++i) fired[i] = pattern == 0 || (pattern >> (i % 8) & 1u);
    image.width = width;
    image.fired = fired.data();
    for (std::size_t row = 0; row < lidarcodec::kMaskRows; ++row) {
      image.half[row] = mixed ? row % 3 == 0 : row >= 32;
      image.rotation[row] = static_cast<std::int32_t>(static_cast<std::uint32_t>(turned * row) * 40503001u);
    }
  }
  FuzzGeometry(const FuzzGeometry&) = delete;
  FuzzGeometry& operator=(const FuzzGeometry&) = delete;

  // Returns of what fired; the more holes of 255, the fewer.
  std::vector<std::uint8_t> returns(std::uint8_t holes) const {
    std::vector<std::uint8_t> found(lidarcodec::kMaskRows * image.width);
    for (std::size_t i = 0; i < found.size(); ++i)
      found[i] =
          fired[image.half[i / image.width] * image.width + i % image.width] && (i * 2654435761u >> 7) % 256 >= holes;
    return found;
  }
};
