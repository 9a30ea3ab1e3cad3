// How the rows of a mask lie to each other and to an earlier frame: found by the encoder, sent in the section.
#pragma once
#include <cstddef>
#include <cstdint>

#include "mask/rows.hpp"

namespace lidarcodec {

inline constexpr std::uint32_t kNominalTurn = 2154;  // columns in a full turn: 48 us a firing at 9.67 turns a second

struct MaskShifts {
  std::uint32_t turn = kNominalTurn;  // columns in a full turn; 0: the rows are not shifted
  std::int32_t earlier = 0;           // columns by which the earlier frame lies further to the right
};

// Columns in a turn under which the rows agree best with those above. `rows`: closed-up cells, row after row at
// distance `width`.
std::uint32_t find_turn(const MaskLayout& layout, const std::uint8_t* rows, std::size_t width);

// Cells that differ from the row above, of every fourth row.
std::size_t unlike_above(const MaskLayout& layout, const std::uint8_t* rows, std::size_t width, std::uint32_t turn);

struct EarlierShift {
  std::int32_t columns = 0;  // by which the earlier frame lies to the right where it agrees best: -131 to 131
  std::size_t unlike = 0;    // cells that differ there, of every fourth row
};

// `mask`: (64, width).
EarlierShift find_earlier(const std::uint8_t* mask, std::size_t width, const EarlierMask& earlier);

}  // namespace lidarcodec
