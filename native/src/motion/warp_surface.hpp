// The moved rings as a surface. In each of 2048 directions it is a polyline through the rings, a point of each, and the
// beams of the frame intersect it.
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
inline constexpr int kDirectionBits = 21;
inline constexpr Angle kDirectionWidth = 1u << kDirectionBits;  // 2^32 / kDirections
inline constexpr Angle kWidestGap = 8 * kDirectionWidth;  // 1.4 degrees: points of a ring further apart are not joined
inline constexpr std::size_t kSectors = 64;
inline constexpr std::int64_t kFarthest = 1 << 23;  // 524 m along each axis: points further away are dropped
inline constexpr std::int32_t kNearest = 1'600;     // 0.1 m from the axis: points nearer to it are dropped
inline constexpr std::int32_t kUnknown = 1 << 30;   // distance of a place that does not exist
inline constexpr std::size_t kMostRingsApart = 3;   // rings further apart are not joined
inline constexpr std::int64_t kJumpRatio = 16;  // two lengths further apart than 1/16 of the shorter one: a depth edge

constexpr std::size_t sector_of(Angle angle) { return angle >> 26; }  // 2^32 / kSectors is 2^26

// A point of a ring: its distance from the axis, and its height.
struct Place {
  std::int32_t away, height;
};

// The places of a ring, at most one in each direction.
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

// Lengths at which the beam of a row hits the surface, by direction; the first direction is repeated after the last
// one.
class RowHits {
 public:
  RowHits(const std::int32_t* lengths, std::int64_t distance) : lengths_(lengths), distance_(distance) {}

  // Expected range of the beam at an angle, in range steps; 0: unknown.
  std::uint16_t range(Angle angle) const {
    const std::int64_t left = lengths_[angle / kDirectionWidth], right = lengths_[angle / kDirectionWidth + 1];
    const std::int64_t part = angle % kDirectionWidth;
    std::int64_t length;
    if (left != 0 && right != 0 && std::abs(right - left) * kJumpRatio <= std::min(left, right)) [[likely]] {
      length = left + (((right - left) * part + kDirectionWidth / 2) >> kDirectionBits);
    } else if (left != 0 && right != 0) {
      length = 2 * part < kDirectionWidth ? left : right;
    } else {
      length = left + right;
      if (length == 0) return 0;
    }
    const std::int64_t steps = (length - distance_ + kLengthsPerStep / 2) >> kStepBits;
    return steps > 65'535 ? std::uint16_t{0} : static_cast<std::uint16_t>(std::max<std::int64_t>(steps, 1));
  }

 private:
  const std::int32_t* lengths_;
  std::int64_t distance_;
};

class Surface {
 public:
  // Rows are a little longer than a power of two, or the places of a direction would share lines of the cache.
  static constexpr std::size_t kStride = kDirections + 8;
  static constexpr std::size_t kPlaces = kStride * kRows;

  // rows: those whose beams are intersected, from the top. points, hits: kPlaces each; `hits` is written where `cross`
  // is called. Call `ring` for each row first.
  Surface(const Beams& beams, const std::vector<std::uint8_t>& rows, Place* points, std::int32_t* hits)
      : beams_(beams), rows_(rows), points_(points), hits_(hits) {
    for (std::size_t i = 0; i < rows.size(); ++i) {
      const Beam& beam = beams[rows[i]];
      crossing_[i + 1] = {static_cast<double>(beam.origin_z), static_cast<double>(beam.back),
                          static_cast<double>(beam.tan_elevation) * kTangentStep,
                          static_cast<double>(beam.sec_elevation) * kTangentStep, rows[i] * kStride};
    }
    crossing_[0].origin_z = kBeyondAll;
    crossing_[rows.size() + 1].origin_z = -kBeyondAll;
  }

  // A ring, with no places yet.
  RingPlaces ring(std::size_t row) const {
    std::fill_n(points_ + row * kStride, kDirections, Place{kUnknown, 0});
    return RingPlaces(points_ + row * kStride);
  }

  // Intersects the beams with the surface in this direction and the three after it. direction: a multiple of 4.
  template <class Form>
  void cross(std::size_t direction);

  // The hits of a row's beam.
  RowHits hits_of(std::size_t row) const { return RowHits(hits_ + row * kStride, beams_[row].distance_correction); }

  // Repeats the first direction of each row after the last one. Call `cross` for it first.
  void close() {
    for (const std::size_t row : rows_) hits_[row * kStride + kDirections] = hits_[row * kStride];
  }

 private:
  // A beam as intersections need it: whole numbers, but for the tangent and the secant, which are multiples of 2^-24.
  struct CrossingBeam {
    double origin_z = 0, back = 0, tan_elevation = 0, sec_elevation = 0;
    std::size_t at = 0;  // where its row begins in hits_
  };

  struct Places;
  static FourMasks is_above(const CrossingBeam& beam, const Places& at);
  template <class Form>
  static Fours above(const CrossingBeam& beam, const Places& at);
  static FourMasks jump(const Places& a, const Places& b);
  template <class Form>
  static void intersect(const CrossingBeam& beam, const Places& a, const Places& b, FourMasks passes, Fours& hit);

  // A beam that intersects nothing hits the nearest place that it passes by less than 0.006 of the place's distance.
  // rings: a bit for each ring beside the beam. Gives the place's distance from the axis, or kUnknown.
  double nearest_passed(const CrossingBeam& beam, std::size_t direction, std::uint64_t rings) const;

  // Higher than all points: these are at most 2^25 above or below a beam.
  static constexpr double kBeyondAll = double{1ull << 40};
  static constexpr double kTangentStep = 1.0 / (1 << 24);

  const Beams& beams_;
  const std::vector<std::uint8_t>& rows_;
  // Each beam, between one that passes above everything and one that passes below.
  std::array<CrossingBeam, kRows + 2> crossing_{};
  Place* points_;       // [ring][direction]
  std::int32_t* hits_;  // [row][direction], length along the beam, 0: none
};

}  // namespace lidarcodec
