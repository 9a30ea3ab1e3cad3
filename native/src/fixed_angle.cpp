#include "fixed_angle.hpp"

#include <algorithm>
#include <cstring>

#include "processor.hpp"

namespace lidarcodec {
namespace {

constexpr std::size_t kAtOnce = 16;

constexpr Angle step_of(std::size_t i) { return static_cast<Angle>((kArctangent[i] + 128) >> 8); }

// What a vector is turned by that is above the axis before each step.
constexpr Angle kAllSteps = [] {
  Angle all = 0;
  for (std::size_t i = 0; i < kLandingSteps; ++i) all += step_of(i);
  return all;
}();

struct Four {
  using Numbers = std::int32_t __attribute__((vector_size(16)));
  using Angles = Angle __attribute__((vector_size(16)));
};
struct Eight {
  using Numbers = std::int32_t __attribute__((vector_size(32)));
  using Angles = Angle __attribute__((vector_size(32)));
};

// All steps of two vectors while they are in registers: while one waits for its last step the other one goes on.
template <class Vector>
[[gnu::always_inline]] inline void land_two(std::int32_t* x_at, std::int32_t* y_at, Angle* angle_at) {
  typename Vector::Numbers x[2], y[2];
  typename Vector::Angles angle[2];
  std::memcpy(x, x_at, sizeof x);
  std::memcpy(y, y_at, sizeof y);
  for (std::size_t v = 0; v < 2; ++v) {
    const auto back = x[v] >> 31;  // all ones: on the far side
    angle[v] = (reinterpret_cast<typename Vector::Angles>(back) << 31) + kAllSteps;
    x[v] = (x[v] ^ back) - back;
    y[v] = (y[v] ^ back) - back;
  }
#pragma GCC unroll 20
  for (int i = 0; i < kLandingSteps; ++i) {
    const Angle twice = 2 * step_of(static_cast<std::size_t>(i));
    for (std::size_t v = 0; v < 2; ++v) {
      const auto down = y[v] >> 31;  // all ones: below the axis
      const auto dx = ((x[v] >> i) ^ down) - down, dy = ((y[v] >> i) ^ down) - down;
      x[v] += dy;
      y[v] -= dx;
      angle[v] -= reinterpret_cast<typename Vector::Angles>(down) & twice;
    }
  }
  std::memcpy(x_at, x, sizeof x);
  std::memcpy(y_at, y, sizeof y);
  std::memcpy(angle_at, angle, sizeof angle);
}

using Land = void (*)(std::int32_t*, std::int32_t*, Angle*);

void land_in_fours(std::int32_t* x, std::int32_t* y, Angle* angle) {
  land_two<Four>(x, y, angle);
  land_two<Four>(x + 8, y + 8, angle + 8);
}

#if defined(__x86_64__)
[[gnu::target("avx2")]] void land_in_eights(std::int32_t* x, std::int32_t* y, Angle* angle) { land_two<Eight>(x, y, angle); }
Land quickest() { return quickest_path() == Path::Avx2 ? land_in_eights : land_in_fours; }
#else
Land quickest() { return land_in_fours; }
#endif

}  // namespace

void land(std::int32_t* x, std::int32_t* y, Angle* angle, std::size_t n) {
  static const Land land_some = quickest();
  std::size_t k = 0;
  for (; k + kAtOnce <= n; k += kAtOnce) land_some(x + k, y + k, angle + k);
  if (k == n) return;
  std::int32_t x_left[kAtOnce] = {}, y_left[kAtOnce] = {};
  Angle angle_left[kAtOnce];
  std::copy(x + k, x + n, x_left);
  std::copy(y + k, y + n, y_left);
  land_some(x_left, y_left, angle_left);
  std::copy(x_left, x_left + (n - k), x + k);
  std::copy(angle_left, angle_left + (n - k), angle + k);
}

}  // namespace lidarcodec
