#include "session/points.hpp"

#include <algorithm>
#include <cmath>
#include <numbers>

namespace lidarcodec {
namespace {

constexpr double kAngle = 1e-8, kLength = 1e-7;                       // steps of the calibration table, rad and m
constexpr double kNearAcross = 2.4, kNearAlong = 1.93, kFar = 25.04;  // HDL-64E S3 manual rev. K, appendix F; m
enum Field : std::size_t {
  kRotation,
  kVertical,
  kDistance,
  kDistanceX,
  kDistanceY,
  kVerticalOffset,
  kHorizontalOffset
};

struct Ray {
  double rotation, cos_vertical, sin_vertical, distance, across, along, up, aside;
};

std::array<Ray, kRows> rays_of(const Sensor& sensor) {
  std::array<Ray, kRows> rays;
  for (std::size_t row = 0; row < kRows; ++row) {
    const auto of = [&](Field field) { return sensor.value(field, row) * (field <= kVertical ? kAngle : kLength); };
    const double distance = of(kDistance);
    rays[row] = {of(kRotation),
                 std::cos(of(kVertical)),
                 std::sin(of(kVertical)),
                 distance,
                 (of(kDistanceX) - distance) / (kFar - kNearAcross),
                 (of(kDistanceY) - distance) / (kFar - kNearAlong),
                 of(kVerticalOffset),
                 of(kHorizontalOffset)};
  }
  return rays;
}

}  // namespace

std::vector<CloudPoint> points_of(const SessionFrame& frame, bool both) {
  if (frame.images) return cloud_of(*frame.images, frame.stamp_ns, both);
  const Planes& planes = frame.planes;
  const Sensor& sensor = *frame.sensor;
  const std::array<Ray, kRows> rays = rays_of(sensor);
  const bool ros = sensor.convention == 0;
  const double step = sensor.range_step * kLength;
  std::vector<CloudPoint> points;
  for (std::size_t column = 0; column < planes.width; ++column)
    for (std::size_t row = 0; row < kRows; ++row) {
      const std::size_t cell = row * planes.width + column;
      if (planes.range[cell] == 0) continue;
      const Ray& ray = rays[row];
      const double beta =
          planes.azimuth[sensor.beams.half[row] * planes.width + column] * std::numbers::pi / 18'000 - ray.rotation;
      const double cos_beta = std::cos(beta), sin_beta = std::sin(beta);
      const double distance = planes.range[cell] * step + ray.distance;
      const double flat = distance * ray.cos_vertical - (ros ? ray.up * ray.sin_vertical : 0);
      double x = flat * cos_beta + ray.aside * sin_beta, y = ray.aside * cos_beta - flat * sin_beta;
      double z = distance * ray.sin_vertical + ray.up * (ros ? ray.cos_vertical : 1);
      if (ros) {
        const double along = ray.along * std::max(kFar - std::abs(x), 0.0),
                     across = ray.across * std::max(kFar - std::abs(y), 0.0);
        x += along * ray.cos_vertical * cos_beta;
        y -= across * ray.cos_vertical * sin_beta;
        z += along * ray.sin_vertical;
      }
      points.push_back({static_cast<float>(x), static_cast<float>(y), static_cast<float>(z), planes.intensity[cell],
                        static_cast<std::uint32_t>(cell), sensor.laser[row], static_cast<std::uint8_t>(row), 1,
                        frame.stamp_ns});
    }
  return points;
}

}  // namespace lidarcodec
