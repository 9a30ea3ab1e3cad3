#include "packets/points.hpp"

#include <algorithm>
#include <cmath>
#include <cstring>

namespace lidarcodec {
namespace {

constexpr double kFar = 25.04;  // m; HDL-64E S3 manual rev. K, appendix F

std::size_t count_of(const PointImages& images) {
  std::size_t count = 0;
  for (std::size_t cell = 0; cell < kPointRows * images.width; ++cell)
    count += images.range[cell] != 0 && (images.keep == nullptr || images.keep[cell] != 0);
  return count;
}

}  // namespace

std::vector<std::uint8_t> points_of_returns(const PointImages& images, const PointBeam* beams, double range_step,
                                            bool turned, bool two_point) {
  std::vector<std::uint8_t> points(count_of(images) * kPointBytes);
  std::uint8_t* out = points.data();
  for (std::size_t column = 0; column < images.width; ++column)
    for (std::size_t row = 0; row < kPointRows; ++row) {
      const std::size_t cell = row * images.width + column;
      if (images.range[cell] == 0 || (images.keep != nullptr && images.keep[cell] == 0)) continue;
      const PointBeam& beam = beams[row];
      const std::size_t half = (beam.lower ? images.width : 0) + column;
      const double cosine = images.cosine[half], sine = images.sine[half];
      const double cos_beta = cosine * beam.cos_rotation + sine * beam.sin_rotation;
      const double sin_beta = sine * beam.cos_rotation - cosine * beam.sin_rotation;
      const double distance = images.range[cell] * range_step + beam.distance;
      const double flat = distance * beam.cos_vertical - (turned ? beam.up * beam.sin_vertical : 0.0);
      double x = flat * cos_beta + beam.aside * sin_beta, y = beam.aside * cos_beta - flat * sin_beta;
      double z = distance * beam.sin_vertical + beam.up * (turned ? beam.cos_vertical : 1.0);
      if (two_point) {
        const double across = beam.near_across * std::max(kFar - std::abs(y), 0.0);
        const double along = beam.near_along * std::max(kFar - std::abs(x), 0.0);
        x += along * beam.cos_vertical * cos_beta;
        y -= across * beam.cos_vertical * sin_beta;
        z += along * beam.sin_vertical;
      }
      const float xyz[3] = {static_cast<float>(x), static_cast<float>(y), static_cast<float>(z)};
      std::memcpy(out, xyz, sizeof xyz);
      out[12] = images.intensity[cell];
      out[13] = beam.laser;
      out[14] = static_cast<std::uint8_t>(row);
      std::memcpy(out + 15, images.t_ns + column, sizeof *images.t_ns);
      out += kPointBytes;
    }
  return points;
}

}  // namespace lidarcodec
