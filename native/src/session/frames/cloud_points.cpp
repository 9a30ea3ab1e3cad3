#include "session/frames/cloud_points.hpp"

#include <algorithm>
#include <cmath>
#include <string_view>
#include <utility>

namespace lidarcodec {
namespace {

constexpr std::size_t kLookedAt = 8192;
constexpr double kMostLevel = 65'535, kMostSeconds = 1e6, kSecondNs = 1e9;
// Absolute times beyond the first are in ns; farther than the second from that of the message, they are of another
// clock, and from one another of none.
constexpr double kLatestSeconds = 1e10, kAwaySeconds = 1000;

double finite(double value) { return std::isfinite(value) ? value : 0.0; }

// Whether higher rows look higher, by some of the points.
bool rises(const CloudAxes& axes, const CloudRows& image) {
  std::vector<std::size_t> returned;
  for (std::size_t i = 0; i < axes.returned.size(); ++i)
    if (axes.returned[i]) returned.push_back(i);
  if (returned.size() < 2) return false;
  const std::size_t step = std::max<std::size_t>(1, returned.size() / kLookedAt);
  std::vector<double> up, row;
  for (std::size_t i = 0; i < returned.size(); i += step) {
    const std::size_t point = returned[i];
    up.push_back(std::atan2(axes.z[point], std::hypot(axes.x[point], axes.y[point])));
    row.push_back(static_cast<double>(image.row[point]));
  }
  const auto mean = [](const std::vector<double>& values) {
    double sum = 0;
    for (const double value : values) sum += value;
    return sum / static_cast<double>(values.size());
  };
  const double mean_up = mean(up), mean_row = mean(row);
  double together = 0;
  for (std::size_t i = 0; i < up.size(); ++i) together += (row[i] - mean_row) * (up[i] - mean_up);
  return together > 0;
}

// Rows of points in no order, by elevation.
std::vector<std::int64_t> rows_by_elevation(const CloudAxes& axes, std::size_t rows) {
  std::vector<double> up;
  double top = 0, bottom = 0;
  bool any = false;
  for (std::size_t i = 0; i < axes.x.size(); ++i) {
    up.push_back(std::atan2(axes.z[i], std::hypot(axes.x[i], axes.y[i])));
    if (!axes.returned[i]) continue;
    top = any ? std::max(top, up.back()) : up.back();
    bottom = any ? std::min(bottom, up.back()) : up.back();
    any = true;
  }
  const double span = std::max(top - bottom, 1e-6);
  std::vector<std::int64_t> found;
  for (const double one : up)
    found.push_back(static_cast<std::int64_t>((top - one) / span * static_cast<double>(rows)));
  return found;
}

// The row of each point, 0 at the top.
std::vector<std::int64_t> rings_of(const DecodedCloud& cloud, const CloudPoints& points, const CloudAxes& axes,
                                   std::size_t rows) {
  std::optional<CloudRows> image = cloud.image ? cloud.image : rows_of(points, axes);
  std::vector<std::int64_t> found;
  if (image) {
    const bool turned = rises(axes, *image);
    found = std::move(image->row);
    for (std::int64_t& row : found) row = turned ? static_cast<std::int64_t>(image->rows) - 1 - row : row;
  } else {
    found = rows_by_elevation(axes, rows);
  }
  for (std::int64_t& row : found) row = std::clamp<std::int64_t>(row, 0, static_cast<std::int64_t>(rows) - 1);
  return found;
}

// Whole numbers up to 65,535 of the field `intensity`, else `reflectivity` or `i`; fractions of 1 count in 255ths.
std::vector<std::uint32_t> intensities_of(const CloudPoints& points) {
  std::vector<std::uint32_t> found(points.size());
  const CloudField* const field = intensity_field(points);
  if (field == nullptr) return found;
  double most = 0;
  bool whole = true;
  for (std::size_t i = 0; i < found.size(); ++i) {
    const double value = finite(points.number(*field, i));
    most = std::max(most, value);
    whole = whole && value == std::nearbyint(value);
  }
  const double scale = field->is_float() && most > 0 && most <= 1 && !whole ? 255.0 : 1.0;
  for (std::size_t i = 0; i < found.size(); ++i) {
    const double level = std::nearbyint(finite(points.number(*field, i)) * scale);
    found[i] = static_cast<std::uint32_t>(std::clamp(level, 0.0, kMostLevel));
  }
  return found;
}

// Seconds of absolute times after that of the message. Those of another clock, as of a sensor that nobody set, count
// from the earliest one; 0 where there is no time.
std::vector<double> after(std::vector<double> times, double begin) {
  std::vector<double> known;
  for (const double time : times)
    if (time != 0) known.push_back(time);
  if (known.empty()) return times;
  const auto at = known.begin() + static_cast<std::ptrdiff_t>((known.size() - 1) / 2);
  std::nth_element(known.begin(), at, known.end());
  const double unit = std::abs(*at) > kLatestSeconds ? kSecondNs : 1.0, middle = *at / unit;
  const auto is_known = [&](double time) { return time != 0 && std::abs(time / unit - middle) <= kAwaySeconds; };
  if (std::abs(middle - begin) > kAwaySeconds) {
    begin = middle;
    for (const double time : times)
      if (is_known(time)) begin = std::min(begin, time / unit);
  }
  for (double& time : times) time = is_known(time) ? time / unit - begin : 0.0;
  return times;
}

// Time of each point after that of the message, by the fields of drivers; 0 without one.
std::vector<std::int64_t> times_of(const CloudPoints& points) {
  std::vector<std::int64_t> found(points.size());
  for (const char* const name : {"time", "t", "time_stamp", "timestamp"}) {
    const CloudField* const field = points.head().named(name);
    if (field == nullptr) continue;
    std::vector<double> values(found.size());
    for (std::size_t i = 0; i < found.size(); ++i) values[i] = points.number(*field, i);
    if (field->is_float()) {
      for (double& value : values) value = finite(value);
      if (std::string_view(name) == "timestamp")
        values = after(std::move(values), static_cast<double>(points.head().stamp_ns) * 1e-9);
      for (double& value : values) value = std::nearbyint(std::clamp(value, -kMostSeconds, kMostSeconds) * kSecondNs);
    }
    for (std::size_t i = 0; i < found.size(); ++i) found[i] = static_cast<std::int64_t>(values[i]);
    break;
  }
  return found;
}

// A driver's own number of a ring, in 8 bits.
std::uint8_t laser_of(double ring) {
  constexpr double kTooLarge = 9.2e18;
  return std::abs(ring) < kTooLarge ? static_cast<std::uint8_t>(static_cast<std::int64_t>(ring)) : std::uint8_t{0};
}

bool is_shown(const CloudPoints& points) { return points.size() > 0 && points.size() <= kMostCloudPoints; }

}  // namespace

const CloudField* intensity_field(const CloudPoints& points) {
  const CloudField* field = nullptr;
  for (const char* const name : {"intensity", "reflectivity", "i"})
    if (field == nullptr) field = points.head().named(name);
  return field;
}

std::size_t returns_of_cloud(const CloudPoints& points) {
  const std::optional<CloudAxes> axes = is_shown(points) ? axes_of(points) : std::nullopt;
  return axes ? static_cast<std::size_t>(std::count(axes->returned.begin(), axes->returned.end(), true)) : 0;
}

std::vector<CloudPoint> points_of_cloud(const DecodedCloud& cloud, std::size_t rows, std::int64_t stamp_ns) {
  std::vector<CloudPoint> found;
  const std::optional<CloudPoints> points = CloudPoints::of(cloud.payload);
  if (!points || !is_shown(*points)) return found;
  const std::optional<CloudAxes> axes = axes_of(*points);
  if (!axes) return found;
  const std::vector<std::int64_t> rings = rings_of(cloud, *points, *axes, rows), times = times_of(*points);
  const std::vector<std::uint32_t> intensities = intensities_of(*points);
  const CloudField* const lasers = points->head().named("ring");
  for (std::size_t i = 0; i < points->size(); ++i) {
    if (!axes->returned[i]) continue;
    const auto ring = static_cast<std::uint8_t>(rings[i]);
    const std::uint8_t laser = lasers == nullptr ? ring : laser_of(points->number(*lasers, i));
    const auto since = static_cast<std::uint64_t>(times[i]) + static_cast<std::uint64_t>(stamp_ns);
    found.push_back({static_cast<float>(axes->x[i]), static_cast<float>(axes->y[i]), static_cast<float>(axes->z[i]),
                     intensities[i], static_cast<std::uint32_t>(i), laser, ring, 1, static_cast<std::int64_t>(since)});
  }
  return found;
}

}  // namespace lidarcodec
