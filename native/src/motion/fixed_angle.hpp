// Angles, sines and polar coordinates in whole numbers: every machine gets the same ones. A turn is 2^32 and wraps.
//
// Sines and polar coordinates are computed by CORDIC (J. E. Volder, "The CORDIC trigonometric computing technique", IRE
// Transactions on Electronic Computers EC-8, 1959): n rotations by +-atan(2^-i), each of shifts and additions only.
// Each one lengthens the vector by sqrt(1 + 4^-i). The product of these factors is the CORDIC gain, 1.646760258 for n =
// 16 or more. tools/angle_tables.py prints the constants.
#pragma once
#include <array>
#include <cstddef>
#include <cstdint>

namespace lidarcodec {

using Angle = std::uint32_t;

inline constexpr std::int64_t kTableStepsPerTurn = 628'318'531;  // 2 pi in the calibration table's steps of 1e-8 rad
inline constexpr std::int64_t kAnglePerRadian = 683'565'276;     // 2^32 / (2 pi)
inline constexpr std::uint32_t kAzimuthStepsPerTurn = 36'000;    // steps of 0.01 degree
inline constexpr int kVectoringSteps = 20;                       // the last one turns by 2^-19 rad

// The CORDIC gain for 16 or more rotations, and its inverse in steps of 2^-30.
inline constexpr double kCordicGain = 1.646760258;
inline constexpr std::int64_t kInverseCordicGain = 652'032'874;

// atan(2^-i) in steps of 2^-40 of a turn, rounded.
inline constexpr std::array<std::int64_t, 30> kArctangent = {
    137438953472, 81134951838, 42869480287, 21761217566, 10922836750, 5466743129, 2734038620, 1367102738,
    683561799,    341782203,   170891265,   85445653,    42722829,    21361415,   10680707,   5340354,
    2670177,      1335088,     667544,      333772,      166886,      83443,      41722,      20861,
    10430,        5215,        2608,        1304,        652,         326};

// a / 2^30, rounded.
constexpr std::int64_t rounded30(std::int64_t a) { return (a + (std::int64_t{1} << 29)) >> 30; }

// a / b, rounded down; b > 0.
constexpr std::int64_t floor_divided(std::int64_t a, std::int64_t b) { return a / b - (a % b < 0); }

// Angle of steps of 1e-8 rad, any number of them.
constexpr Angle angle_of_table(std::int32_t steps) {
  std::int64_t wrapped = steps % kTableStepsPerTurn;
  if (wrapped < 0) wrapped += kTableStepsPerTurn;
  return static_cast<Angle>(
      static_cast<std::uint64_t>(((wrapped << 32) + kTableStepsPerTurn / 2) / kTableStepsPerTurn));
}

// Angle of an azimuth, 0 to 35999 steps of 0.01 degree.
constexpr Angle angle_of_azimuth(std::uint32_t azimuth) {
  return static_cast<Angle>(((static_cast<std::uint64_t>(azimuth) << 32) + kAzimuthStepsPerTurn / 2) /
                            kAzimuthStepsPerTurn);
}

struct CosSin {
  std::int32_t cos, sin;  // steps of 2^-30
};

// Cosine and sine of an angle, with errors below 2^-28: CORDIC in rotation mode, 30 rotations with 10 guard bits. Signs
// are masks and not branches, because a processor cannot predict them.
inline CosSin cos_sin(Angle angle) {
  const bool back = angle + 0x40000000u >= 0x80000000u;
  const Angle within = back ? angle + 0x80000000u : angle;
  std::int64_t left = static_cast<std::int64_t>(static_cast<std::int32_t>(within)) * 256;
  std::int64_t x = kInverseCordicGain * 1024, y = 0;
  for (std::size_t i = 0; i < kArctangent.size(); ++i) {
    const std::int64_t under = left >> 63;  // all ones: the angle that is left is negative
    const std::int64_t dx = ((x >> i) ^ under) - under, dy = ((y >> i) ^ under) - under;
    x -= dy;
    y += dx;
    left -= (kArctangent[i] ^ under) - under;
  }
  if (back) x = -x, y = -y;
  return {static_cast<std::int32_t>((x + 512) >> 10), static_cast<std::int32_t>((y + 512) >> 10)};
}

// Polar coordinates of n vectors (x, y), each part up to 2^27: CORDIC in vectoring mode. Then x holds the length times
// kCordicGain, and `angle` the direction, with an error below 2^-19 rad; y is spent.
void to_polar(std::int32_t* x, std::int32_t* y, Angle* angle, std::size_t n);

}  // namespace lidarcodec
