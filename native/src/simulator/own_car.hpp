// The roof of the car that carries the sensor.
#pragma once
#include "simulator/math.hpp"
#include "simulator/sensor.hpp"

namespace lidarcodec::sim {

// The distance at which a beam meets the roof of the own car, its bars or its aerials; 0 if it does not. They hide part
// of the road.
inline double own_car_at(const Beam& b, std::uint64_t luck) {
  if (b.direction.z > -0.2) return 0;
  const double ragged = 0.03 * unit_of(luck);
  double t = 0, x = 0, y = 0;
  const auto at = [&](double z) {
    t = (z - b.origin.z) / b.direction.z;
    x = b.origin.x + t * b.direction.x;
    y = b.origin.y + t * b.direction.y;
  };
  at(-0.23);
  if (x < 0.92 + ragged && x > -1.08 - ragged && abs_of(y) < 0.52 + ragged) return t;
  at(-0.14);  // roof bars
  if (abs_of(abs_of(x + 0.1) - 0.62) < 0.03 + ragged && abs_of(y) < 0.68 + ragged) return t;
  at(-0.08);  // aerials
  const bool met = (x + 0.75) * (x + 0.75) + (y - 0.42) * (y - 0.42) < 0.008 ||
                   (x + 0.8) * (x + 0.8) + (y + 0.35) * (y + 0.35) < 0.005;
  return met ? t : 0;
}

}  // namespace lidarcodec::sim
