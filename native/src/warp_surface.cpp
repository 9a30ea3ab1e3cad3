#include "warp_surface.hpp"

namespace lidarcodec {

void Surface::cross(std::size_t direction) {
  std::array<Place, kRows> places;        // those of the rings that have one
  std::array<std::uint8_t, kRows> ring, below;  // the ring of each, and how many beams pass above it or through it
  const std::size_t beams = rows_.size();
  std::size_t n = 0, pass = 0;
  const Place* at = points_ + direction;
  for (std::size_t r = 0; r < kRows; ++r, at += kStride) {
    if (at->away == kUnknown) continue;
    places[n] = *at;
    while (pass < beams && above(pass, *at) <= 0) ++pass;
    while (pass > 0 && above(pass - 1, *at) > 0) --pass;
    ring[n] = static_cast<std::uint8_t>(r);
    below[n++] = static_cast<std::uint8_t>(pass);
  }
  std::array<std::int64_t, kRows> met{};  // distance of each beam's meeting from the axis
  std::uint64_t open = beams == kRows ? ~std::uint64_t{0} : (std::uint64_t{1} << beams) - 1;
  for (std::size_t k = 1; k < n; ++k) {
    const std::size_t first = std::min(below[k - 1], below[k]), end = std::max(below[k - 1], below[k]);
    if (first == end || ring[k] - ring[k - 1] > static_cast<int>(kRingsApart)) continue;
    const Place &a = places[k - 1], &b = places[k];
    const bool jump = jumps(a, b);
    for (std::size_t beam = first; beam < end; ++beam) {
      const std::int64_t from = above(beam, a), to = above(beam, b);
      if ((from > 0) == (to > 0)) continue;
      std::int64_t away;
      if (jump) {
        away = 2 * std::abs(from) < std::abs(from - to) ? a.away : b.away;
      } else {
        away = a.away + (b.away - a.away) * from / (from - to);
      }
      if (away + asking_[beam].back <= 0) continue;
      if ((open >> beam & 1u) != 0 || away < met[beam]) met[beam] = away;
      open &= ~(std::uint64_t{1} << beam);
    }
  }
  if (open != 0) graze(open, met, places.data(), below.data(), n);
  for (std::size_t beam = 0; beam < beams; ++beam) {
    const std::int64_t away = met[beam] + asking_[beam].back;
    if (met[beam] == 0 || away <= 0) continue;
    const std::size_t row = rows_[beam];
    met_[row * kStride + direction] = static_cast<std::int32_t>((away * beams_[row].lengthen) >> 24);
  }
}

void Surface::graze(std::uint64_t open, std::array<std::int64_t, kRows>& met, const Place* places, const std::uint8_t* below, std::size_t n) const {
  std::array<std::int64_t, kRows> off{};
  for (std::size_t k = 0; k < n; ++k) {
    const Place& at = places[k];
    for (std::size_t beam = below[k] - (below[k] != 0); beam <= below[k] && beam < rows_.size(); ++beam) {
      if ((open >> beam & 1u) == 0) continue;
      const std::int64_t by = std::abs(above(beam, at));
      if (by * 500 >= std::int64_t{at.away} * 3 || (met[beam] != 0 && by * met[beam] >= off[beam] * at.away)) continue;
      off[beam] = by, met[beam] = at.away;
    }
  }
}

}  // namespace lidarcodec
