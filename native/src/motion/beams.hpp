// The beams of a sensor in whole numbers: lengths in 1/16 mm, 32 of them in a range step of 2 mm; factors in 2^-30.
#pragma once
#include <algorithm>
#include <array>
#include <cstdint>

#include "motion/fixed_angle.hpp"
#include "motion/range_history.hpp"

namespace lidarcodec {

inline constexpr std::int64_t kLengthsPerStep = 32;
inline constexpr std::int64_t kMostDistance = 128'000;  // 8 m: a larger correction is no correction and is cut
inline constexpr std::int64_t kMostOffset = 2'048;      // 128 mm: likewise, of vertical and horizontal offsets
inline constexpr std::int32_t kLeastCosine = 1 << 28;   // 75.5 degrees up or down: steeper beams expect nothing

// Rows of the calibration table, of each row of the image, in its steps (1e-8 rad, 1e-7 m).
struct BeamTable {
  std::array<std::int32_t, kRows> rotation{}, vertical{}, distance{}, vertical_offset{}, horizontal_offset{};
  Halves half{};
};

struct Point {
  std::int64_t x, y, z;  // forward, left, up
};

struct Beam {
  bool usable = false;
  Angle rotation = 0;
  std::int64_t distance = 0, sideways = 0;  // corrections of its length and to its right, 1/16 mm
  std::int64_t along = 0, across = 0, up = 0, along_0 = 0, across_0 = 0, up_0 = 0;
  std::int64_t slope = 0, lengthen = 0;  // tan and 1 / cos of its elevation, 2^-24
  std::int64_t back = 0;                 // what its origin lies behind the axis

  Beam() = default;
  Beam(const BeamTable& table, std::size_t row) {
    rotation = angle_of_table(table.rotation[row]);
    const Turned turn = turned(rotation), rise = turned(angle_of_table(table.vertical[row]));
    usable = rise.cos >= kLeastCosine;
    if (!usable) return;
    distance = length(table.distance[row], kMostDistance);
    sideways = length(table.horizontal_offset[row], kMostOffset);
    const std::int64_t offset = length(table.vertical_offset[row], kMostOffset);
    back = rounded30(offset * rise.sin);
    along = rounded30(std::int64_t{rise.cos} * turn.cos);
    across = rounded30(std::int64_t{rise.cos} * turn.sin);
    up = rise.sin;
    along_0 = rounded30(-back * turn.cos - sideways * turn.sin);
    across_0 = rounded30(-back * turn.sin + sideways * turn.cos);
    up_0 = rounded30(offset * rise.cos);
    slope = divided_down(std::int64_t{rise.sin} * (1 << 24), rise.cos);
    lengthen = divided_down(std::int64_t{1} << 54, rise.cos);
  }

  // Where a range of it lies, its block being at an azimuth with this cosine and sine.
  Point point(std::int64_t length_along, Turned azimuth) const {
    const std::int64_t p = rounded30(length_along * along) + along_0, q = rounded30(length_along * across) + across_0;
    return {rounded30(p * azimuth.cos + q * azimuth.sin), rounded30(q * azimuth.cos - p * azimuth.sin),
            rounded30(length_along * up) + up_0};
  }

 private:
  static std::int64_t length(std::int32_t steps, std::int64_t most) {
    return std::clamp(divided_down(std::int64_t{steps} + 312, 625), -most, most);
  }
};

using Beams = std::array<Beam, kRows>;

inline Beams beams_of(const BeamTable& table) {
  Beams beams;
  for (std::size_t row = 0; row < kRows; ++row) beams[row] = Beam(table, row);
  return beams;
}

// T_current_previous: rotation (row major, 2^-30) and translation (1/16 mm).
struct Motion {
  std::array<std::int32_t, 9> rotation{1 << 30, 0, 0, 0, 1 << 30, 0, 0, 0, 1 << 30};
  std::array<std::int32_t, 3> translation{};
};

}  // namespace lidarcodec
