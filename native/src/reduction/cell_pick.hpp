// One point a cubic cell, the side of the cells found for a budget. Whole numbers: the same choice on every machine.
#pragma once
#include <cstddef>
#include <cstdint>
#include <vector>

namespace lidarcodec {

inline constexpr std::int32_t kLeastSide = 32;         // 2 mm, in 1/16 mm
inline constexpr std::int32_t kMostSide = 16'000'000;  // a kilometre

struct Picked {
  std::vector<std::uint32_t> places;  // of the points chosen, in the order given
  std::int32_t side = 0;              // of the cells, 1/16 mm
};

// xyz: (count, 3), 1/16 mm, each within 2^22; order: (count,), places in that list, the first in a cell is chosen;
// side: where to begin the search, the last frame's.
// Chosen are `want` points or up to a fiftieth more; fewer only if there are no cells that small. With count <= want: all.
// Raises Section if a place or a point is out of range.
Picked pick_cells(const std::int32_t* xyz, const std::uint32_t* order, std::size_t count, std::size_t want,
                  std::int32_t side);

}  // namespace lidarcodec
