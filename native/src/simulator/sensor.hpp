// The simulated HDL-64E S2: origin, direction, corrections and noise of its 64 lasers.
#pragma once
#include <array>
#include <cstdint>
#include <vector>

#include "base/rows.hpp"
#include "simulator/math.hpp"

namespace lidarcodec::sim {

constexpr int kLasers = static_cast<int>(kRows);

// Calibration of one laser in the steps of the sensor's own status bytes: 0.01 degree, 1 mm, focal slope 0.1.
struct LaserRow {
  std::int16_t rot_cdeg, vert_cdeg, dist_mm, vert_offset_mm, horiz_offset_mm, focal_mm, slope_tenth;
};
extern const std::array<LaserRow, kLasers> kLaserTable;
constexpr int kMinIntensity = 0;
constexpr int kMaxIntensity = 255;

// A beam in the sensor's frame (x forward, y left, z up): origin + distance * direction, the ROS form of the model.
struct Beam {
  V3 origin, direction;
};

class Sensor {
 public:
  explicit Sensor(std::uint64_t seed);

  // Beam of a laser at a rotation of `azimuth` hundredths of a degree, a multiple of 9 below 36000.
  Beam beam(int laser, int azimuth) const;

  double dist_m(int laser) const { return lasers_[static_cast<std::size_t>(laser)].dist; }
  double sigma_m(int laser) const { return lasers_[static_cast<std::size_t>(laser)].sigma; }
  double gain(int laser) const { return lasers_[static_cast<std::size_t>(laser)].gain; }
  double offset(int laser) const { return lasers_[static_cast<std::size_t>(laser)].offset; }
  double reach(int laser) const { return lasers_[static_cast<std::size_t>(laser)].reach; }
  // Range error in metres, periodic in the count of firings with period 24.
  double ripple_m(int laser, std::uint64_t firing) const {
    return ripple_[static_cast<std::size_t>(laser) * 24 + firing % 24];
  }

 private:
  struct Laser {
    double cos_rot, sin_rot, cos_vert, sin_vert, vert_offset, horiz_offset, dist, sigma, gain, offset, reach;
  };
  std::array<Laser, kLasers> lasers_;
  std::vector<double> ripple_;  // [64][24]
  std::vector<V2> rotation_;    // cosine and sine of each of the 4000 rotation positions
};

}  // namespace lidarcodec::sim
