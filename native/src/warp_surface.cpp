#include "warp_surface.hpp"

namespace lidarcodec {
namespace {

// A depth edge, or two surfaces at one height: nothing is between them.
bool jumps(const Place& a, const Place& b) {
  const std::int32_t apart = std::abs(b.away - a.away), near = std::min(a.away, b.away);
  return apart * 20 > near * 7 ||
         (apart > 150 * kLengthsPerStep && apart * 4 > near && std::abs(b.height - a.height) * 50 < apart);
}

}  // namespace

void Surface::cross(std::size_t direction) {
  Column column;
  std::array<Passing, kRows * kRows> passings;
  const std::size_t passed = descend(direction, column, passings.data());

  std::array<std::int32_t, kRows> met;  // distance of each beam's meeting from the axis
  const std::size_t beams = rows_.size();
  std::fill_n(met.begin(), beams, kUnknown);
  std::uint64_t open = beams == kRows ? ~std::uint64_t{0} : (std::uint64_t{1} << beams) - 1;
  for (std::size_t i = 0; i < passed; ++i) {
    const std::size_t beam = passings[i].beam;
    const Place &a = column.places[passings[i].place - 1u], &b = column.places[passings[i].place];
    const std::int64_t from = above(asking_[beam + 1], a), to = above(asking_[beam + 1], b);
    if ((from > 0) == (to > 0)) continue;
    // Exact: what is divided is below 2^50, and doubles of whole numbers below 2^53 divide and cut off as these do.
    const auto part = static_cast<std::int32_t>(static_cast<double>((b.away - a.away) * from) / static_cast<double>(from - to));
    const std::int32_t closer = 2 * std::abs(from) < std::abs(from - to) ? a.away : b.away;
    const std::int32_t away = jumps(a, b) ? closer : a.away + part;
    if (away + asking_[beam + 1].back <= 0) continue;
    met[beam] = std::min(met[beam], away);
    open &= ~(std::uint64_t{1} << beam);
  }
  if (open != 0) graze(open, met.data(), column);
  for (std::size_t beam = 0; beam < beams; ++beam) {
    const std::int64_t away = met[beam] + asking_[beam + 1].back;
    const bool meets = met[beam] != kUnknown && away > 0;
    met_[asking_[beam + 1].at + direction] = meets ? static_cast<std::int32_t>((away * asking_[beam + 1].lengthen) >> 24) : 0;
  }
}

// Whether a ring has a place, and whether one beam more passes above it or none, is as good as random: there are no branches for
// it. More beams, or fewer, are seldom.
std::size_t Surface::descend(std::size_t direction, Column& column, Passing* passings) const {
  constexpr int kRings = static_cast<int>(kRows);
  constexpr std::size_t kNextLine = 8;  // the same ring's places in directions to come; rings are too far apart for the processor to see it
  const Place* points = points_ + direction;
  std::size_t n = 0, passed = 0, now = 0;
  int ring_before = -kRings;
  for (int ring = 0; ring < kRings; ++ring, points += kStride) {
    __builtin_prefetch(points + kNextLine);
    const Place& at = *points;
    const bool known = at.away != kUnknown;
    const bool joined = ring - ring_before <= static_cast<int>(kRingsApart);
    const bool rises = (above(asking_[now + 1], at) <= 0) & known;
    passings[passed] = {static_cast<std::uint8_t>(n), static_cast<std::uint8_t>(now)};
    passed += rises & joined;
    now += rises;
    if ((above(asking_[known ? now + rises : 0], at) <= 0) == rises) [[unlikely]] {
      do {
        now -= !rises;
        passings[passed] = {static_cast<std::uint8_t>(n), static_cast<std::uint8_t>(now)};
        passed += joined;
        now += rises;
      } while ((above(asking_[now + rises], at) <= 0) == rises);
    }
    column.places[n] = at;
    column.below[n] = static_cast<std::uint8_t>(now);
    n += known;
    ring_before = known ? ring : ring_before;
  }
  column.size = n;
  return passed;
}

void Surface::graze(std::uint64_t open, std::int32_t* met, const Column& column) const {
  std::array<std::int64_t, kRows> off{};
  for (std::size_t k = 0; k < column.size; ++k) {
    const std::size_t below = column.below[k];
    if (((below == 0 ? open << 1 : open >> (below - 1)) & 3u) == 0) continue;
    const Place& at = column.places[k];
    for (std::size_t beam = below - (below != 0); beam <= below && beam < rows_.size(); ++beam) {
      if ((open >> beam & 1u) == 0) continue;
      const std::int64_t by = std::abs(above(asking_[beam + 1], at));
      if (by * 500 >= std::int64_t{at.away} * 3 || (met[beam] != kUnknown && by * met[beam] >= off[beam] * at.away)) continue;
      off[beam] = by;
      met[beam] = at.away;
    }
  }
}

}  // namespace lidarcodec
