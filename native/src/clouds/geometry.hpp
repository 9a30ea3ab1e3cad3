// x, y and z of points of a range image, from a range, a direction and the geometry of each row; in Python
// lidarcodec/planes/clouds/geometry.py, which has the formula. The operations are those of docs/wire-format-clouds.md,
// in its order, so that every machine computes the same bits.
#pragma once
#include <array>
#include <bit>
#include <cmath>
#include <cstdint>
#include <limits>
#include <vector>

namespace lidarcodec {

inline constexpr double kFullTurn = 6.283185307179586;

// Sense and quarters by which a driver rounds directions; (0, 0): it does not.
struct AngleForm {
  int sense, quarters;
};
inline constexpr std::array<AngleForm, 7> kAngleForms = {{{0, 0}, {-1, 0}, {1, 0}, {-1, 1}, {1, 1}, {-1, 3}, {1, 3}}};

// Of a row: rho = along D + along_m, z = up D + up_m, phi = (k + turned) / U.
struct CloudRow {
  double along = 0, along_m = 0, up = 0, up_m = 0, aside_m = 0, turned = 0;
};

struct CloudGeometry {
  double step_m = 0;
  std::uint32_t turn = 1;   // steps of a turn
  bool narrow = false;      // whether the driver computes in binary32
  std::uint8_t angles = 0;  // a place in kAngleForms
  std::vector<CloudRow> rows;
};

// Before rounding to binary32; rho: distance from the axis.
struct CloudPlace {
  double x, y, z, rho;
};

// The nearest whole number, halves to the even one; |value| below 2^51.
inline double nearest(double value) {
  constexpr double kShift = 6755399441055744.0;  // 3 * 2^51
  return (value + kShift) - kShift;
}

struct Turned {
  double cosine, sine;
};

// Of an angle in turns, within 1e-15.
inline Turned cosine_sine(double turns) {
  constexpr double kShift = 6755399441055744.0;
  const double shifted = turns * 4.0 + kShift, quarter = shifted - kShift;
  const std::uint64_t turned = std::bit_cast<std::uint64_t>(shifted);  // modulo 4 that of the quarters
  const double angle = (turns - quarter * 0.25) * kFullTurn, square = angle * angle;
  double sine = -1.0 / 1307674368000.0;
  sine = sine * square + 1.0 / 6227020800.0;
  sine = sine * square + -1.0 / 39916800.0;
  sine = sine * square + 1.0 / 362880.0;
  sine = sine * square + -1.0 / 5040.0;
  sine = sine * square + 1.0 / 120.0;
  sine = sine * square + -1.0 / 6.0;
  sine = sine * square + 1.0;
  sine = sine * angle;
  double cosine = -1.0 / 87178291200.0;
  cosine = cosine * square + 1.0 / 479001600.0;
  cosine = cosine * square + -1.0 / 3628800.0;
  cosine = cosine * square + 1.0 / 40320.0;
  cosine = cosine * square + -1.0 / 720.0;
  cosine = cosine * square + 1.0 / 24.0;
  cosine = cosine * square + -1.0 / 2.0;
  cosine = cosine * square + 1.0;
  const bool swapped = (turned & 1) != 0;
  const double c = swapped ? sine : cosine, s = swapped ? cosine : sine;
  return {((turned + 1) & 2) != 0 ? -c : c, (turned & 2) != 0 ? -s : s};
}

// A direction in turns as the driver has it in radians, in binary32.
inline float driver_radians(double turns, AngleForm form) {
  const double angle = turns * form.sense + form.quarters * 0.25;
  return static_cast<float>((angle - std::floor(angle)) * kFullTurn);
}

// The same in turns, as the driver has it.
inline double driver_turns(double turns, AngleForm form) {
  if (form.sense == 0) return turns;
  return (static_cast<double>(driver_radians(turns, form)) / kFullTurn - form.quarters * 0.25) * form.sense;
}

// The point of a range n and a direction k in a row.
inline CloudPlace place_of(const CloudGeometry& geometry, const CloudRow& row, std::uint32_t n, std::int32_t k) {
  const double turns =
      driver_turns((static_cast<double>(k) + row.turned) / geometry.turn, kAngleForms[geometry.angles]);
  const Turned at = cosine_sine(turns);
  if (!geometry.narrow) {
    const double distance = static_cast<double>(n) * geometry.step_m;
    const double rho = row.along * distance + row.along_m, up = row.up * distance + row.up_m;
    return {rho * at.cosine - row.aside_m * at.sine, rho * at.sine + row.aside_m * at.cosine, up, rho};
  }
  const auto f = [](double value) { return static_cast<float>(value); };
  const float distance = static_cast<float>(n) * f(geometry.step_m);
  const float rho = distance * f(row.along) + f(row.along_m), up = distance * f(row.up) + f(row.up_m);
  const float cosine = f(at.cosine), sine = f(at.sine), aside = f(row.aside_m);
  return {rho * cosine - aside * sine, rho * sine + aside * cosine, up, rho};
}

// binary32 as whole numbers in the same order; neighbours differ by 1. -0.0 is 1 less than 0.0.
inline std::int64_t ordered(float value) {
  const auto bits = static_cast<std::int64_t>(std::bit_cast<std::int32_t>(value));
  return bits >= 0 ? bits : -(bits & 0x7FFFFFFF) - 1;
}

// The inverse, of numbers held within 32 bits.
inline float from_ordered(std::int64_t number) {
  constexpr std::int64_t kLeast = std::numeric_limits<std::int32_t>::min(),
                         kMost = std::numeric_limits<std::int32_t>::max();
  const std::int64_t held = number < kLeast ? kLeast : number > kMost ? kMost : number;
  const std::int64_t bits = held >= 0 ? held : (-(held + 1)) | 0x80000000;
  return std::bit_cast<float>(static_cast<std::uint32_t>(bits));
}

}  // namespace lidarcodec
