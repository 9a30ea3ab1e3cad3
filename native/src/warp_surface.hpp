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

// A point of a ring: its distance from the axis, and its height.
struct Place {
  std::int32_t away, height;
};

// The places of a ring, one for each direction.
class RingPlaces {
 public:
  explicit RingPlaces(Place* places) : places_(places) {}

  // Of several places in a direction the nearest stays.
  void put(std::uint32_t direction, Place at) const {
    Place& place = places_[direction % kDirections];
    if (at.away < place.away) place = at;
  }

 private:
  Place* places_;
};

class Surface {
 public:
  // Rows a little longer than the turn: else a column's places would all fall into the same lines of the cache.
  static constexpr std::size_t kStride = kDirections + 8;
  static constexpr std::size_t kPlaces = kStride * kRows;

  // rows: those whose beams ask, from the top; points, met: kPlaces each, those of `met` 0.
  Surface(const Beams& beams, const std::vector<std::uint8_t>& rows, Place* points, std::int32_t* met)
      : beams_(beams), rows_(rows), points_(points), met_(met) {
    std::fill(points, points + kPlaces, Place{kUnknown, 0});
    for (std::size_t i = 0; i < rows.size(); ++i) asking_[i] = {beams[rows[i]].up_0, beams[rows[i]].back, beams[rows[i]].slope};
  }

  RingPlaces ring(std::size_t row) const { return RingPlaces(points_ + row * kStride); }

  // Finds what each beam that looks in this direction meets first.
  void cross(std::size_t direction);

  // What the beam of a row meets when it looks at this angle, range steps, 0: unknown.
  std::uint16_t range(Angle angle, std::size_t row) const {
    const std::uint32_t direction = angle / kDirection;
    const std::int64_t left = met_[row * kStride + direction], right = met_[row * kStride + (direction + 1) % kDirections];
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
  struct Asking {
    std::int64_t up_0, back, slope;
  };

  // How far the point lies above a beam.
  std::int64_t above(std::size_t beam, const Place& at) const {
    const Asking& asking = asking_[beam];
    return at.height - asking.up_0 - (((at.away + asking.back) * asking.slope) >> 24);
  }

  // A depth edge, or two surfaces at one height: nothing is between them.
  static bool jumps(const Place& a, const Place& b) {
    const std::int64_t apart = std::abs(std::int64_t{b.away} - a.away), near = std::min(a.away, b.away);
    return apart * 20 > near * 7 ||
           (apart > 150 * kLengthsPerStep && apart * 4 > near && std::abs(std::int64_t{b.height} - a.height) * 50 < apart);
  }

  // An open beam, one that meets nothing, but passes a point within 0.006 of its distance: it meets the closest such point.
  void graze(std::uint64_t open, std::array<std::int64_t, kRows>& met, const Place* places, const std::uint8_t* below,
             std::size_t n) const;

  const Beams& beams_;
  const std::vector<std::uint8_t>& rows_;
  std::array<Asking, kRows> asking_{};
  Place* points_;      // [ring][direction]
  std::int32_t* met_;  // [row][direction], length along the beam, 0: none
};

}  // namespace lidarcodec
