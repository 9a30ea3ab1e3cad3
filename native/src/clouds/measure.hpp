// From a point of a cloud to its range and direction in its row.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>

#include "clouds/geometry.hpp"

namespace lidarcodec {

inline constexpr std::uint32_t kMostCloudRange = (1u << 20) - 1;
inline constexpr std::uint32_t kFineTurn = 1u << 18;  // steps of a turn from which on directions are computed exactly

// Within 1e-7.
inline double quick_atan2(double y, double x) {
  const double along = std::abs(x), aside = std::abs(y);
  const double more = std::max(along, aside), less = std::min(along, aside), slope = more > 0 ? less / more : 0.0;
  const double square = slope * slope;
  double angle = -0.00466877330769732;
  for (const double factor : {0.02416618952245364, -0.05936710078955759, 0.09906096894976094, -0.1401658504209942,
                              0.1996923539480227, -0.3333195972432491, 0.9999998977538569})
    angle = angle * square + factor;
  angle *= slope;
  if (aside > along) angle = kFullTurn / 4 - angle;
  if (x < 0) angle = kFullTurn / 2 - angle;
  return y < 0 ? -angle : angle;
}

// Range and direction of a point that lies in a row.
struct Measured {
  std::uint32_t n;
  std::int32_t k;
};

// The same of all points of a row.
class Measure {
 public:
  Measure(const CloudGeometry& geometry, const CloudRow& row)
      : aside_(row.aside_m),
        by_height_(std::abs(row.along) <= 0.1 && row.up != 0),
        scale_(1 / ((by_height_                  ? row.up
                     : std::abs(row.along) > 0.1 ? row.along
                                                 : 1.0) *
                    geometry.step_m)),
        begin_((by_height_ ? row.up_m : row.along_m) * scale_),
        steps_(geometry.turn / kFullTurn),
        turned_(row.turned),
        exact_(geometry.turn > kFineTurn) {}

  Measured operator()(double x, double y, double z) const {
    const double square = x * x + y * y - aside_ * aside_, along = std::sqrt(std::max(square, 0.0));
    const double steps = (by_height_ ? z : along) * scale_ - begin_;
    const double held = steps > 1 ? std::min(steps, static_cast<double>(kMostCloudRange)) : 1.0;
    const double cosine = x * along + y * aside_, sine = y * along - x * aside_;
    const double turned = (exact_ ? std::atan2(sine, cosine) : quick_atan2(sine, cosine)) * steps_ - turned_;
    return {static_cast<std::uint32_t>(nearest(held)),
            static_cast<std::int32_t>(nearest(std::clamp(turned, -1e9, 1e9)))};
  }

 private:
  double aside_;
  bool by_height_;
  double scale_, begin_, steps_, turned_;
  bool exact_;
};

}  // namespace lidarcodec
