// What the sensor reports of a hit: reach, dropouts, noise and the byte of intensity.
#pragma once
#include <array>

#include "simulator/scene.hpp"
#include "simulator/sensor.hpp"

namespace lidarcodec::sim {

struct Echo {
  std::uint16_t range = 0;  // steps of 2 mm, 0 = no return
  std::uint8_t intensity = 0;
};

class Receiver {
 public:
  explicit Receiver(const Sensor& sensor, std::uint64_t seed) : sensor_(sensor), seed_(seed) {}

  // The return of a laser for a hit, at firing number `firing`.
  Echo receive(int laser, std::uint64_t firing, const Hit& hit);

 private:
  const Sensor& sensor_;
  std::uint64_t seed_;
  std::array<double, kLasers> before_{};  // last distance of each laser, 0 = none
};

constexpr double kReach = 120.0;  // metres, HDL-64E S2 manual
constexpr double kNearest = 0.9;  // metres: the sensor reports nothing nearer

}  // namespace lidarcodec::sim
