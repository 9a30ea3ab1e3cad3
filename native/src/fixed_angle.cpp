#include "fixed_angle.hpp"

namespace lidarcodec {

// Loops that compilers make vector code of: not inlined, and without promises about aliases, with which gcc 12 makes slower code.
void land(std::int32_t* x, std::int32_t* y, Angle* angle, std::size_t n) {
  for (std::size_t k = 0; k < n; ++k) {
    const std::int32_t back = x[k] >> 31;  // all ones: on the far side
    angle[k] = static_cast<Angle>(back) & 0x80000000u;
    x[k] = (x[k] ^ back) - back;
    y[k] = (y[k] ^ back) - back;
  }
  for (int i = 0; i < kLandingSteps; ++i) {
    const auto by = static_cast<std::int32_t>((kArctangent[static_cast<std::size_t>(i)] + 128) >> 8);
    for (std::size_t k = 0; k < n; ++k) {
      const std::int32_t down = y[k] >> 31;  // all ones: below the axis
      const std::int32_t dx = ((x[k] >> i) ^ down) - down, dy = ((y[k] >> i) ^ down) - down;
      x[k] += dy;
      y[k] -= dx;
      angle[k] += static_cast<Angle>((by ^ down) - down);
    }
  }
}

}  // namespace lidarcodec
