#include "motion/warp_surface.hpp"

#include <bit>
#include <cmath>

namespace lidarcodec {

double Surface::graze(const Asking& beam, std::size_t direction, std::uint64_t rings) const {
  double met = kUnknown, off = 0;
  for (; rings != 0; rings &= rings - 1) {
    const Place& at = points_[static_cast<std::size_t>(std::countr_zero(rings)) * kStride + direction];
    const double away = at.away, by = std::abs(at.height - beam.up_0 - std::floor((away + beam.back) * beam.slope));
    if (by * 500 >= away * 3 || (met != kUnknown && by * met >= off * away)) continue;
    off = by;
    met = away;
  }
  return met;
}

}  // namespace lidarcodec
