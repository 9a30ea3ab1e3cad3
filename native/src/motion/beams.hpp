// The beams of a sensor in whole numbers. Lengths are in units of 1/16 mm, 32 of them in a range step of 2 mm. Cosines,
// sines and other factors are in steps of 2^-30, where nothing else is said.
#pragma once
#include <algorithm>
#include <array>
#include <cstdint>

#include "motion/fixed_angle.hpp"
#include "motion/range_history.hpp"

namespace lidarcodec {

inline constexpr int kStepBits = 5;
inline constexpr std::int64_t kLengthsPerStep = 1 << kStepBits;
inline constexpr std::int64_t kTableStepsPerLength = 625;         // steps of 1e-7 m in 1/16 mm
inline constexpr std::int64_t kMostDistanceCorrection = 128'000;  // 8 m; larger ones are cut
inline constexpr std::int64_t kMostOffset = 2'048;     // 128 mm; larger vertical and horizontal offsets are cut
inline constexpr std::int32_t kLeastCosine = 1 << 28;  // cosine of 75.5 degrees: steeper beams are not used

// What the calibration table says of each row of the image, in the table's steps: 1e-8 rad and 1e-7 m.
struct BeamTable {
  std::array<std::int32_t, kRows> rotation{}, vertical{}, distance{}, vertical_offset{}, horizontal_offset{};
  Halves half{};
};

struct Point {
  std::int64_t x, y, z;  // forward, left, up
};

struct Beam {
  bool usable = false;
  Angle rotation = 0;                    // rotation correction
  std::int64_t distance_correction = 0;  // added to a range
  std::int64_t horizontal_offset = 0;    // of the laser, to the right
  // In the frame of its block, x along the block's azimuth: where the beam begins, and its unit vector.
  std::int64_t origin_x = 0, origin_y = 0, origin_z = 0, direction_x = 0, direction_y = 0, direction_z = 0;
  std::int64_t tan_elevation = 0, sec_elevation = 0;  // steps of 2^-24
  std::int64_t back = 0;                              // how far the origin lies behind the axis of the sensor

  Beam() = default;
  Beam(const BeamTable& table, std::size_t row) {
    rotation = angle_of_table(table.rotation[row]);
    const CosSin rotation_cs = cos_sin(rotation), elevation = cos_sin(angle_of_table(table.vertical[row]));
    usable = elevation.cos >= kLeastCosine;
    if (!usable) return;
    distance_correction = length(table.distance[row], kMostDistanceCorrection);
    horizontal_offset = length(table.horizontal_offset[row], kMostOffset);
    const std::int64_t offset = length(table.vertical_offset[row], kMostOffset);
    back = rounded30(offset * elevation.sin);
    direction_x = rounded30(std::int64_t{elevation.cos} * rotation_cs.cos);
    direction_y = rounded30(std::int64_t{elevation.cos} * rotation_cs.sin);
    direction_z = elevation.sin;
    origin_x = rounded30(-back * rotation_cs.cos - horizontal_offset * rotation_cs.sin);
    origin_y = rounded30(-back * rotation_cs.sin + horizontal_offset * rotation_cs.cos);
    origin_z = rounded30(offset * elevation.cos);
    tan_elevation = floor_divided(std::int64_t{elevation.sin} * (1 << 24), elevation.cos);
    sec_elevation = floor_divided(std::int64_t{1} << 54, elevation.cos);
  }

  // The point at a corrected range, when the block's azimuth has this cosine and sine.
  Point point(std::int64_t length, CosSin azimuth) const {
    const std::int64_t p = rounded30(length * direction_x) + origin_x, q = rounded30(length * direction_y) + origin_y;
    return {rounded30(p * azimuth.cos + q * azimuth.sin), rounded30(q * azimuth.cos - p * azimuth.sin),
            rounded30(length * direction_z) + origin_z};
  }

 private:
  static std::int64_t length(std::int32_t table_steps, std::int64_t most) {
    return std::clamp(floor_divided(std::int64_t{table_steps} + kTableStepsPerLength / 2, kTableStepsPerLength), -most,
                      most);
  }
};

using Beams = std::array<Beam, kRows>;

inline Beams beams_of(const BeamTable& table) {
  Beams beams;
  for (std::size_t row = 0; row < kRows; ++row) beams[row] = Beam(table, row);
  return beams;
}

// T_current_previous: rotation (row major, steps of 2^-30) and translation (1/16 mm).
struct Motion {
  std::array<std::int32_t, 9> rotation{1 << 30, 0, 0, 0, 1 << 30, 0, 0, 0, 1 << 30};
  std::array<std::int32_t, 3> translation{};
};

}  // namespace lidarcodec
