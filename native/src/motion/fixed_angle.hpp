// Angles and turns in whole numbers, so that every machine gets the same ones. A turn is 2^32 and wraps.
// The constants are printed by tools/angle_tables.py.
#pragma once
#include <array>
#include <cstddef>
#include <cstdint>

namespace lidarcodec {

using Angle = std::uint32_t;

inline constexpr std::int64_t kTurnOfTable = 628'318'531;      // full turn in steps of 1e-8 rad
inline constexpr std::int64_t kAngleOfRadian = 683'565'276;    // 2^32 / 2 pi
inline constexpr std::int64_t kShrink = 652'032'874;           // what 20 or more CORDIC steps stretch by, inverse, 2^-30
inline constexpr std::uint32_t kAzimuths = 36'000;             // steps of 0.01 degree in a turn
inline constexpr int kLandingSteps = 20;

// atan(2^-i), 2^40 in a turn
inline constexpr std::array<std::int64_t, 30> kArctangent = {
    137438953472, 81134951838, 42869480287, 21761217566, 10922836750, 5466743129, 2734038620, 1367102738,
    683561799,    341782203,   170891265,   85445653,    42722829,    21361415,   10680707,   5340354,
    2670177,      1335088,     667544,      333772,      166886,      83443,      41722,      20861,
    10430,        5215,        2608,        1304,        652,         326};

// a / 2^30, rounded.
constexpr std::int64_t rounded30(std::int64_t a) { return (a + (std::int64_t{1} << 29)) >> 30; }

// a / b rounded down, b > 0.
constexpr std::int64_t divided_down(std::int64_t a, std::int64_t b) { return a / b - (a % b < 0); }

constexpr Angle angle_of_table(std::int32_t steps) {
  std::int64_t wrapped = steps % kTurnOfTable;
  if (wrapped < 0) wrapped += kTurnOfTable;
  return static_cast<Angle>(static_cast<std::uint64_t>(((wrapped << 32) + kTurnOfTable / 2) / kTurnOfTable));
}

// azimuth: 0 to 35999
constexpr Angle angle_of_azimuth(std::uint32_t azimuth) {
  return static_cast<Angle>(((static_cast<std::uint64_t>(azimuth) << 32) + kAzimuths / 2) / kAzimuths);
}

struct Turned {
  std::int32_t cos, sin;  // 2^-30
};

// Cosine and sine, within 2^-28. Without branches: which way a step turns is as good as random.
inline Turned turned(Angle angle) {
  const bool back = angle + 0x40000000u >= 0x80000000u;
  const Angle within = back ? angle + 0x80000000u : angle;
  std::int64_t left = static_cast<std::int64_t>(static_cast<std::int32_t>(within)) * 256;
  std::int64_t x = kShrink * 1024, y = 0;
  for (std::size_t i = 0; i < kArctangent.size(); ++i) {
    const std::int64_t under = left >> 63;  // all ones: turned too far
    const std::int64_t dx = ((x >> i) ^ under) - under, dy = ((y >> i) ^ under) - under;
    x -= dy;
    y += dx;
    left -= (kArctangent[i] ^ under) - under;
  }
  if (back) x = -x, y = -y;
  return {static_cast<std::int32_t>((x + 512) >> 10), static_cast<std::int32_t>((y + 512) >> 10)};
}

// Turns (x, y), each up to 2^27, onto the x axis, n of them: then x is their length times 1.6467, and `angle` what they
// were turned by, within 2^-19 rad.
void land(std::int32_t* x, std::int32_t* y, Angle* angle, std::size_t n);

}  // namespace lidarcodec
