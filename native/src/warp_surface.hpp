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

// What the beam of a row meets in each direction, and in the first again.
class MetByRow {
 public:
  MetByRow(const std::int32_t* lengths, std::int64_t distance) : lengths_(lengths), distance_(distance) {}

  // When it looks at this angle: range steps, 0: unknown.
  std::uint16_t range(Angle angle) const {
    const std::int64_t left = lengths_[angle / kDirection], right = lengths_[angle / kDirection + 1];
    const std::int64_t part = angle % kDirection;
    std::int64_t length;
    if (left != 0 && right != 0 && std::abs(right - left) * 16 <= std::min(left, right)) [[likely]] {
      length = left + (((right - left) * part + kDirection / 2) >> 21);
    } else if (left != 0 && right != 0) {
      length = 2 * part < kDirection ? left : right;
    } else {
      length = left + right;
      if (length == 0) return 0;
    }
    const std::int64_t steps = (length - distance_ + kLengthsPerStep / 2) >> 5;
    return steps > 65'535 ? std::uint16_t{0} : static_cast<std::uint16_t>(std::max<std::int64_t>(steps, 1));
  }

 private:
  const std::int32_t* lengths_;
  std::int64_t distance_;
};

class Surface {
 public:
  // Rows a little longer than the turn: else a column's places would all fall into the same lines of the cache.
  static constexpr std::size_t kStride = kDirections + 8;
  static constexpr std::size_t kPlaces = kStride * kRows;

  // rows: those whose beams ask, from the top; points, met: kPlaces each, those of `met` 0 where `cross` is not called. Call `ring` for
  // each row first.
  Surface(const Beams& beams, const std::vector<std::uint8_t>& rows, Place* points, std::int32_t* met)
      : beams_(beams), rows_(rows), points_(points), met_(met) {
    for (std::size_t i = 0; i < rows.size(); ++i) {
      const Beam& beam = beams[rows[i]];
      asking_[i + 1] = {beam.up_0, beam.back, beam.slope, beam.lengthen, rows[i] * kStride};
    }
    asking_[0] = {kBeyondAll};
    asking_[rows.size() + 1] = {-kBeyondAll};
  }

  // A ring, with no places yet.
  RingPlaces ring(std::size_t row) const {
    std::fill_n(points_ + row * kStride, kDirections, Place{kUnknown, 0});
    return RingPlaces(points_ + row * kStride);
  }

  // Finds what each beam that looks in this direction meets first.
  void cross(std::size_t direction);

  // What the beams of a row meet, by direction. Call `close` first.
  MetByRow met_by(std::size_t row) const { return MetByRow(met_ + row * kStride, beams_[row].distance); }

  // After the last direction of a row comes the first.
  void close() {
    for (const std::size_t row : rows_) met_[row * kStride + kDirections] = met_[row * kStride];
  }

 private:
  struct Asking {
    std::int64_t up_0 = 0, back = 0, slope = 0, lengthen = 0;
    std::size_t at = 0;  // of its row, in met_
  };

  // The places of a direction, from the top, of the rings that have one.
  struct Column {
    std::array<Place, kRows> places;
    std::array<std::uint8_t, kRows> below;  // how many beams pass above each or through it
    std::size_t size = 0;
  };

  // A beam that passes between a place and the one before it.
  struct Passing {
    std::uint8_t place, beam;
  };

  // How far the point lies above a beam.
  static std::int64_t above(const Asking& asking, const Place& at) {
    return at.height - asking.up_0 - (((at.away + asking.back) * asking.slope) >> 24);
  }

  // Finds the places of a direction, and the beams that pass between two of them; how many. They are at most 64 for each place.
  std::size_t descend(std::size_t direction, Column& column, Passing* passings) const;

  // An open beam, one that meets nothing, but passes a point within 0.006 of its distance: it meets the closest such point.
  void graze(std::uint64_t open, std::int32_t* met, const Column& column) const;

  // Points are at most 2^25 above or below a real beam: this is above all of them.
  static constexpr std::int64_t kBeyondAll = std::int64_t{1} << 40;

  const Beams& beams_;
  const std::vector<std::uint8_t>& rows_;
  std::array<Asking, kRows + 2> asking_{};  // of each beam, with one before them that passes above everything and one after them below
  Place* points_;                           // [ring][direction]
  std::int32_t* met_;                       // [row][direction], length along the beam, 0: none
};

}  // namespace lidarcodec
