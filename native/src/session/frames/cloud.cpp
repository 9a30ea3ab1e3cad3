#include "session/frames/cloud.hpp"

#include "session/frames/cloud_points.hpp"

namespace lidarcodec {
namespace {

std::uint32_t value_at(const PlaneImage* plane, std::size_t cell) { return plane == nullptr ? 0 : (*plane)[cell]; }

// Modulo 2^64: times of hostile packets may be anything.
std::int64_t sum(std::int64_t a, std::int64_t b) {
  return static_cast<std::int64_t>(static_cast<std::uint64_t>(a) + static_cast<std::uint64_t>(b));
}

}  // namespace

std::vector<CloudPoint> cloud_of(const ImageFrame& frame, std::int64_t stamp_ns, bool both) {
  if (frame.cloud) return points_of_cloud(*frame.cloud, frame.sensor->rows(), stamp_ns);
  std::vector<CloudPoint> points;
  const std::unique_ptr<FrameGeometry> geometry = frame.geometry();
  if (geometry == nullptr) return points;
  const std::vector<std::size_t> packets = frame.rest.regular();
  const PlaneImage *const first = frame.plane("range"), *const second = frame.plane("range2"),
                          *const intensity = frame.plane("intensity"), *const intensity2 = frame.plane("intensity2");
  const PlaneImage* const of_second = intensity2 == nullptr ? intensity : intensity2;
  const std::size_t rows = frame.sensor->rows(), width = frame.width;
  for (std::uint8_t number = 1; number <= (both && frame.layout->two_returns ? 2 : 1); ++number) {
    const PlaneImage* const ranges = number == 1 ? first : second;
    if (ranges == nullptr) continue;
    for (std::size_t column = 0; column < width; ++column) {
      const std::int64_t packet_ns = sum(stamp_ns, frame.rest.packet_ns[packets[column / frame.layout->columns]]);
      for (std::size_t row = 0; row < rows; ++row) {
        const std::size_t cell = row * width + column;
        const std::uint32_t range = (*ranges)[cell];
        if (range == 0 || (number == 2 && range == (*first)[cell] &&
                           (intensity2 == nullptr || (*intensity2)[cell] == value_at(intensity, cell))))
          continue;
        const std::array<double, 3> at = geometry->point(row, column, range);
        points.push_back({static_cast<float>(at[0]), static_cast<float>(at[1]), static_cast<float>(at[2]),
                          value_at(number == 1 ? intensity : of_second, cell), static_cast<std::uint32_t>(cell),
                          frame.sensor->laser[row], static_cast<std::uint8_t>(row), number,
                          sum(packet_ns, geometry->since_stamp_ns(row, column))});
      }
    }
  }
  return points;
}

}  // namespace lidarcodec
