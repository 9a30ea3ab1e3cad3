// Voxel sampling: one point in each cubic voxel, with the side that meets a budget. In whole numbers, so every machine
// chooses the same points.
#pragma once
#include <cstddef>
#include <cstdint>
#include <vector>

namespace lidarcodec {

inline constexpr std::int32_t kLeastSide = 32;         // 2 mm, in 1/16 mm
inline constexpr std::int32_t kMostSide = 16'000'000;  // a kilometre

struct Picked {
  std::vector<std::uint32_t> places;  // of the chosen points, in the order given
  std::int32_t side = 0;              // of the voxels, 1/16 mm
};

// xyz: (count, 3), 1/16 mm, each within 2^22. order: (count,), places in that list; the first point of a voxel is
// chosen. side: where the search begins, that of the last frame. Gives `want` points, or up to 2 % more; fewer only if
// no voxel is small enough. With count <= want: all points. Raises Section if a place or a point is out of range.
Picked pick_cells(const std::int32_t* xyz, const std::uint32_t* order, std::size_t count, std::size_t want,
                  std::int32_t side);

}  // namespace lidarcodec
