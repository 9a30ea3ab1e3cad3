#include "session/frames/ring_geometry.hpp"

#include <algorithm>
#include <cmath>
#include <numbers>

namespace lidarcodec {
namespace {

constexpr std::size_t kColumns = 256;      // by which the rings are fitted
constexpr std::uint32_t kFarRange = 4096;  // the second of two ranges, in steps
constexpr std::uint32_t kMostBits = 16;

// Columns evenly over the frame.
std::vector<std::size_t> chosen_columns(std::size_t width) {
  const std::size_t count = std::min(kColumns, width);
  std::vector<std::size_t> columns;
  for (std::size_t i = 0; i < count; ++i) columns.push_back(count == 1 ? 0 : i * (width - 1) / (count - 1));
  return columns;
}

}  // namespace

std::vector<RingGeometry> ring_geometry(const ImageFrame& frame) {
  std::vector<RingGeometry> rings(frame.sensor->rows());
  const std::unique_ptr<FrameGeometry> geometry = frame.geometry();
  if (geometry == nullptr || frame.width == 0) return rings;
  const std::vector<std::size_t> columns = chosen_columns(frame.width);
  const auto count = static_cast<double>(columns.size());
  const double far_m = kFarRange * (frame.sensor->range_step * kLengthStep);
  for (std::size_t row = 0; row < rings.size(); ++row) {
    double cos_turn = 0, sin_turn = 0, elevation = 0, forward = 0, aside = 0, height = 0;
    for (const std::size_t column : columns) {
      const std::array<double, 3> near = geometry->point(row, column, 0), far = geometry->point(row, column, kFarRange);
      const double x = (far[0] - near[0]) / far_m, y = (far[1] - near[1]) / far_m, z = (far[2] - near[2]) / far_m;
      const double beta = std::atan2(-y, x), turn = frame.azimuth[column] * std::numbers::pi / 18'000 - beta;
      cos_turn += std::cos(turn);
      sin_turn += std::sin(turn);
      elevation += std::atan2(z, std::hypot(x, y));
      forward += near[0] * std::cos(beta) - near[1] * std::sin(beta);
      aside += near[0] * std::sin(beta) + near[1] * std::cos(beta);
      height += near[2];
    }
    RingGeometry& ring = rings[row];
    ring.rotation = std::atan2(sin_turn, cos_turn);
    ring.elevation = elevation / count;
    ring.distance = forward / count / std::cos(ring.elevation);
    ring.height = height / count - ring.distance * std::sin(ring.elevation);
    ring.aside = aside / count;
  }
  return rings;
}

std::uint32_t shown_step(const ImageFrame& frame) {
  const std::uint32_t bits = frame.planes.empty() ? kMostBits : frame.planes[0].bits;
  return bits > kMostBits ? 1u << (bits - kMostBits) : 1;
}

std::vector<std::uint16_t> shown_ranges(const ImageFrame& frame) {
  std::vector<std::uint16_t> shown;
  if (frame.planes.empty()) return shown;
  const std::uint32_t step = shown_step(frame);
  for (const std::uint32_t range : frame.planes[0].values)
    shown.push_back(range == 0 ? 0 : static_cast<std::uint16_t>(std::clamp((range + step / 2) / step, 1u, 65'535u)));
  return shown;
}

std::vector<std::uint8_t> shown_intensities(const ImageFrame& frame) {
  std::vector<std::uint8_t> shown;
  if (const PlaneImage* const plane = frame.plane("intensity"))
    for (const std::uint32_t value : *plane) shown.push_back(static_cast<std::uint8_t>(std::min(value, 255u)));
  return shown;
}

}  // namespace lidarcodec
