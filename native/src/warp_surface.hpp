// The moved rings as a surface: in each of 2048 directions a polyline of up to 64 points, one of each ring, and where the
// beams that look there meet it.
#pragma once
#include <algorithm>
#include <array>
#include <cstdint>
#include <cstdlib>
#include <vector>

#include "beams.hpp"

namespace lidarcodec {

inline constexpr std::size_t kDirections = 2048;
inline constexpr Angle kDirection = 1u << 21;         // 2^32 / kDirections
inline constexpr Angle kWidestStretch = 8 * kDirection;  // 1.4 degrees: points of a ring further apart are not joined
inline constexpr std::size_t kSectors = 64;
inline constexpr std::int64_t kFarthest = 1 << 23;    // 524 m along each axis: what moves further is left out
inline constexpr std::int32_t kNearest = 1'600;       // 0.1 m from the axis: likewise nearer
inline constexpr std::int32_t kUnknown = 1 << 30;
inline constexpr std::size_t kRingsApart = 3;         // rings further apart are not joined

constexpr std::size_t sector_of(Angle angle) { return angle >> 26; }

class Surface {
 public:
  // rows: those whose beams ask, from the top.
  Surface(const Beams& beams, const std::vector<std::uint8_t>& rows) : beams_(beams), rows_(rows), met_(kDirections * kRows) {
    points_.assign(kDirections * kRows, {kUnknown, 0});
  }

  // A point of a ring, its distance from the axis and height; of several the nearest stays.
  void put(std::uint32_t direction, std::size_t row, std::int32_t away, std::int32_t height) {
    Place& place = points_[(direction % kDirections) * kRows + row];
    if (away < place.away) place = {away, height};
  }

  // Finds what each beam that looks in this direction meets first.
  void cross(std::size_t direction) {
    const Place* points = points_.data() + direction * kRows;
    std::array<std::uint8_t, kRows> ring, below;  // rings with a point, and how many beams pass above it or through it
    std::size_t n = 0, pass = 0;
    for (std::size_t r = 0; r < kRows; ++r) {
      if (points[r].away == kUnknown) continue;
      const Place& at = points[r];
      while (pass < rows_.size() && above(rows_[pass], at) <= 0) ++pass;
      while (pass > 0 && above(rows_[pass - 1], at) > 0) --pass;
      ring[n] = static_cast<std::uint8_t>(r);
      below[n++] = static_cast<std::uint8_t>(pass);
    }
    std::int32_t* met = met_.data() + direction * kRows;
    for (std::size_t k = 1; k < n; ++k) {
      if (ring[k] - ring[k - 1] > static_cast<int>(kRingsApart)) continue;
      const Place &a = points[ring[k - 1]], &b = points[ring[k]];
      const std::size_t end = std::max(below[k - 1], below[k]);
      if (std::min(below[k - 1], below[k]) == end) continue;
      const bool jump = jumps(a, b);
      for (std::size_t beam = std::min(below[k - 1], below[k]); beam < end; ++beam) {
        const std::size_t r = rows_[beam];
        const std::int64_t from = above(r, a), to = above(r, b);
        if ((from > 0) == (to > 0)) continue;
        std::int64_t away;
        if (jump) {
          away = 2 * std::abs(from) < std::abs(from - to) ? a.away : b.away;
        } else {
          away = a.away + (b.away - a.away) * from / (from - to);
        }
        meet(met, r, away);
      }
    }
    graze(met, points, ring.data(), below.data(), n);
  }

  // What the beam of a row meets when it looks at this angle, range steps, 0: unknown.
  std::uint16_t range(Angle angle, std::size_t row) const {
    const std::uint32_t direction = angle / kDirection;
    const std::int64_t left = met_[direction * kRows + row], right = met_[(direction + 1) % kDirections * kRows + row];
    const std::int64_t part = angle % kDirection;
    std::int64_t length;
    if (left != 0 && right != 0 && std::abs(right - left) * 16 <= std::min(left, right)) {
      length = left + (((right - left) * part + kDirection / 2) >> 21);
    } else if (left != 0 && right != 0) {
      length = 2 * part < kDirection ? left : right;
    } else {
      length = left + right;
    }
    if (length == 0) return 0;
    const std::int64_t steps = (length - beams_[row].distance + kLengthsPerStep / 2) >> 5;
    return steps > 65'535 ? std::uint16_t{0} : static_cast<std::uint16_t>(std::max<std::int64_t>(steps, 1));
  }

 private:
  struct Place {
    std::int32_t away, height;
  };

  // How far the point lies above the beam of a row.
  std::int64_t above(std::size_t row, const Place& at) const {
    const Beam& beam = beams_[row];
    return at.height - beam.up_0 - (((at.away + beam.back) * beam.slope) >> 24);
  }

  // A depth edge, or two surfaces at one height: nothing is between them.
  static bool jumps(const Place& a, const Place& b) {
    const std::int64_t apart = std::abs(std::int64_t{b.away} - a.away), near = std::min(a.away, b.away);
    return apart * 20 > near * 7 ||
           (apart > 150 * kLengthsPerStep && apart * 4 > near && std::abs(std::int64_t{b.height} - a.height) * 50 < apart);
  }

  // Keeps the length at which the beam of a row is this far from the axis, if it is the shortest yet.
  void meet(std::int32_t* met, std::size_t row, std::int64_t away) const {
    const std::int64_t length = ((away + beams_[row].back) * beams_[row].lengthen) >> 24;
    if (!beams_[row].usable || length <= 0) return;
    if (met[row] == 0 || length < met[row]) met[row] = static_cast<std::int32_t>(length);
  }

  // A beam that meets nothing, but passes a point within 0.006 of the distance: it meets the closest such point.
  void graze(std::int32_t* met, const Place* points, const std::uint8_t* ring, const std::uint8_t* below,
             std::size_t n) const {
    std::array<std::int64_t, kRows> off{};
    std::array<std::int32_t, kRows> away{};  // 0: no point yet
    for (std::size_t k = 0; k < n; ++k) {
      const Place& at = points[ring[k]];
      for (std::size_t beam = below[k] - (below[k] != 0); beam <= below[k] && beam < rows_.size(); ++beam) {
        const std::size_t r = rows_[beam];
        if (met[r] != 0) continue;
        const std::int64_t by = std::abs(above(r, at));
        if (by * 500 >= std::int64_t{at.away} * 3 || (away[r] != 0 && by * away[r] >= off[r] * at.away)) continue;
        off[r] = by, away[r] = at.away;
      }
    }
    for (std::size_t r = 0; r < kRows; ++r)
      if (away[r] != 0) meet(met, r, away[r]);
  }

  const Beams& beams_;
  const std::vector<std::uint8_t>& rows_;
  std::vector<Place> points_;     // [direction][ring]
  std::vector<std::int32_t> met_;  // [direction][row], length along the beam, 0: none
};

}  // namespace lidarcodec
