// The moved rings as a surface: in each of 2048 directions a polyline of up to 64 points, one of each ring, and where the
// beams that look there meet it.
#pragma once
#include <algorithm>
#include <array>
#include <cstdint>
#include <cstdlib>
#include <vector>

#include "motion/beams.hpp"
#include "motion/warp_fours.hpp"

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
      asking_[i + 1] = {static_cast<double>(beam.up_0), static_cast<double>(beam.back), static_cast<double>(beam.slope) * kFactor,
                        static_cast<double>(beam.lengthen) * kFactor, rows[i] * kStride};
    }
    asking_[0].up_0 = kBeyondAll;
    asking_[rows.size() + 1].up_0 = -kBeyondAll;
  }

  // A ring, with no places yet.
  RingPlaces ring(std::size_t row) const {
    std::fill_n(points_ + row * kStride, kDirections, Place{kUnknown, 0});
    return RingPlaces(points_ + row * kStride);
  }

  // Finds what each beam that looks in this direction or the three after it meets first. direction: a multiple of 4.
  template <class Form>
  void cross(std::size_t direction);

  // What the beams of a row meet, by direction. Call `close` first.
  MetByRow met_by(std::size_t row) const { return MetByRow(met_ + row * kStride, beams_[row].distance); }

  // After the last direction of a row comes the first.
  void close() {
    for (const std::size_t row : rows_) met_[row * kStride + kDirections] = met_[row * kStride];
  }

 private:
  // What of a beam says where it passes: whole numbers, but for its slope and `lengthen`, multiples of 2^-24.
  struct Asking {
    double up_0 = 0, back = 0, slope = 0, lengthen = 0;
    std::size_t at = 0;  // of its row, in met_
  };

  struct Places;
  static FourMasks is_above(const Asking& beam, const Places& at);
  template <class Form>
  static Fours above(const Asking& beam, const Places& at);
  static FourMasks jump(const Places& a, const Places& b);
  template <class Form>
  static void meet(const Asking& beam, const Places& a, const Places& b, FourMasks passes, Fours& met);

  // A beam that meets nothing, but passes a place within 0.006 of its distance, meets the closest such place. rings: those
  // that it passes between. Gives how far it is from the axis.
  double graze(const Asking& beam, std::size_t direction, std::uint64_t rings) const;

  // Points are at most 2^25 above or below a real beam: this is above all of them.
  static constexpr double kBeyondAll = double{1ull << 40};
  static constexpr double kFactor = 1.0 / (1 << 24);

  const Beams& beams_;
  const std::vector<std::uint8_t>& rows_;
  std::array<Asking, kRows + 2> asking_{};  // of each beam, with one before them that passes above everything and one after them below
  Place* points_;                           // [ring][direction]
  std::int32_t* met_;                       // [row][direction], length along the beam, 0: none
};

}  // namespace lidarcodec
