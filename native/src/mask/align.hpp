// Registration of the rows of a mask to each other and to an earlier frame. The encoder finds the shifts and sends
// them.
#pragma once
#include <cstddef>
#include <cstdint>

#include "mask/rows.hpp"

namespace lidarcodec {

inline constexpr std::uint32_t kNominalTurn = 2154;  // columns in a full turn: 48 us a firing at 9.67 turns a second

struct MaskShifts {
  std::uint32_t turn = kNominalTurn;  // columns in a full turn; 0: the rows are not shifted
  std::int32_t earlier = 0;           // shift of the earlier frame to the right, in columns
};

// The number of columns in a turn with the least Hamming distance of rows from the rows above. `rows`: closed-up cells,
// row after row at distance `width`.
std::uint32_t find_turn(const MaskLayout& layout, const std::uint8_t* rows, std::size_t width);

// The Hamming distance of every fourth row from the row above.
std::size_t unlike_above(const MaskLayout& layout, const std::uint8_t* rows, std::size_t width, std::uint32_t turn);

struct EarlierShift {
  std::int32_t columns = 0;  // shift of the earlier frame to the right, with the least distance: -131 to 131
  std::size_t unlike = 0;    // Hamming distance at that shift, of every fourth row
};

// `mask`: (64, width).
EarlierShift find_earlier(const std::uint8_t* mask, std::size_t width, const EarlierMask& earlier);

}  // namespace lidarcodec
