// Mask coder: which cells of a 64 x W image hold a return. The format is docs/wire-format-sections.md, section "mask".
//
// Rows are coded from the top by context templates, as in JBIG (ITU-T T.82): the cells to the left, the two rows above
// and, if there is one, the mask of an earlier frame. The lasers of a firing look up to 18 degrees apart, so the rows
// above are first shifted by their rotation correction. Blocks that did not fire have no cells: a row is the fired
// columns of its half, closed up.
#pragma once
#include <array>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "base/rows.hpp"

namespace lidarcodec {

inline constexpr std::size_t kMaskRows = kRows;

// Kinds of masks that take one byte: no cell is a return, and all fired cells are returns.
inline constexpr std::uint8_t kMaskNone = 0, kMaskAll = 1;

// What encoder and decoder know before the mask.
struct MaskGeometry {
  std::size_t width = 0;
  const std::uint8_t* fired = nullptr;             // (2, W): upper, lower
  std::array<std::uint8_t, kMaskRows> half{};      // of each row: 0 upper, 1 lower
  std::array<std::int64_t, kMaskRows> rotation{};  // of each row: rotation correction, steps of 1e-8 rad
};

// A mask of an earlier frame, (64, width); width 0 for none.
struct EarlierMask {
  const std::uint8_t* cells = nullptr;
  std::size_t width = 0;
};

// `turn`: columns in a full turn, up to 65535; 0: found from the mask. Raises Section if a cell is set in a block that
// did not fire.
std::vector<std::uint8_t> encode_mask(const std::uint8_t* mask, const MaskGeometry& geometry, EarlierMask earlier,
                                      std::uint32_t turn = 0);

// (64, W) of 0 and 1. Raises Section or Truncated.
std::vector<std::uint8_t> decode_mask(const std::uint8_t* data, std::size_t size, const MaskGeometry& geometry,
                                      EarlierMask earlier);

}  // namespace lidarcodec
