#include "motion/warp_surface.hpp"

#include <bit>
#include <cmath>

namespace lidarcodec {

double Surface::nearest_passed(const CrossingBeam& beam, std::size_t direction, std::uint64_t rings) const {
  double nearest = kUnknown, off = 0;
  for (; rings != 0; rings &= rings - 1) {
    const Place& at = points_[static_cast<std::size_t>(std::countr_zero(rings)) * kStride + direction];
    const double away = at.away,
                 by = std::abs(at.height - beam.origin_z - std::floor((away + beam.back) * beam.tan_elevation));
    if (by * 500 >= away * 3 || (nearest != kUnknown && by * nearest >= off * away)) continue;
    off = by;
    nearest = away;
  }
  return nearest;
}

}  // namespace lidarcodec
