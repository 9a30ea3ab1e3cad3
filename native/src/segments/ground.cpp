#include "segments/ground.hpp"

#include <algorithm>
#include <array>
#include <cmath>

namespace lidarcodec {
namespace {

constexpr float kPi = 3.14159265F;
constexpr int kSectors = 180;
constexpr float kNearM = 2.0F, kFarM = 120.0F;  // nearer returns are on the vehicle itself
constexpr float kGroundM = 0.2F;
constexpr float kStepM = 0.12F;      // a kerb, or an uneven road, between two bins
constexpr float kSlope = 0.1F;       // by which a prediction may be off per metre
constexpr float kMostStepM = 0.35F;  // less than the height of bumpers over the ground
constexpr float kSteepest = 0.15F;   // of the ground that is predicted
constexpr float kSlopeM = 5.0F;      // way over which the slope is measured
constexpr float kFirstM = 12.0F;     // up to here the height of the sensor is measured
constexpr float kHeightStepM = 0.05F, kLowestM = -6.0F;
constexpr std::size_t kHeights = 160;  // 8 m from kLowestM upwards
constexpr float kNothing = 1e9F;

// Bins are 0.5 m wide up to 20 m, then 1 m up to 60 m, then 2 m.
constexpr int kBins = 40 + 40 + 30;
int bin_of(float range) {
  if (range < 20.0F) return static_cast<int>(range * 2.0F);
  if (range < 60.0F) return 40 + static_cast<int>(range - 20.0F);
  return 80 + static_cast<int>((range - 60.0F) * 0.5F);
}

struct Low {
  float range = 0, z = kNothing;
};

struct Cell {
  std::int16_t sector = -1, bin = 0;
  float range = 0;
};

// Height of the ground around the vehicle: the most frequent height of the lowest returns near it.
float level_of(const std::vector<Low>& lows) {
  std::array<int, kHeights> counts{};
  for (const Low& low : lows)
    if (low.z < kNothing && low.range < kFirstM) {
      const float at = (low.z - kLowestM) / kHeightStepM;
      if (at >= 0 && at < static_cast<float>(kHeights)) ++counts[static_cast<std::size_t>(at)];
    }
  std::size_t best = 0;
  int most = -1;
  for (std::size_t k = 1; k + 1 < kHeights; ++k) {
    const int sum = counts[k - 1] + counts[k] + counts[k + 1];
    if (sum > most) most = sum, best = k;
  }
  return kLowestM + (static_cast<float>(best) + 0.5F) * kHeightStepM;
}

// Heights of the ground at each bin of a sector.
void follow(const Low* lows, float level, float* heights) {
  std::array<Low, kBins> line;  // bins that belong to the ground
  std::array<int, kBins> bins{};
  int count = 0;
  for (int k = 0; k < kBins; ++k) {
    if (lows[k].z == kNothing) continue;
    float predicted = level, from = 0;
    if (count > 0) {
      const Low& last = line[static_cast<std::size_t>(count - 1)];
      int back = count - 1;
      while (back > 0 && last.range - line[static_cast<std::size_t>(back)].range < kSlopeM) --back;
      const Low& first = line[static_cast<std::size_t>(back)];
      const float way = last.range - first.range;
      const float slope = way > 1.0F ? std::clamp((last.z - first.z) / way, -kSteepest, kSteepest) : 0.0F;
      from = last.range;
      predicted = last.z + slope * (lows[k].range - last.range);
    }
    const float tolerance = std::min(kStepM + kSlope * (lows[k].range - from), kMostStepM);
    if (std::abs(lows[k].z - predicted) > tolerance) continue;
    line[static_cast<std::size_t>(count)] = lows[k];
    bins[static_cast<std::size_t>(count++)] = k;
  }
  // Between bins of the ground, and beyond the last one.
  int next = 0;
  for (int k = 0; k < kBins; ++k) {
    while (next < count && bins[static_cast<std::size_t>(next)] < k) ++next;
    if (count == 0) {
      heights[k] = level;
    } else if (next == 0) {
      heights[k] = line[0].z;
    } else if (next == count) {
      heights[k] = line[static_cast<std::size_t>(count - 1)].z;
    } else {
      const auto a = static_cast<std::size_t>(next - 1), b = static_cast<std::size_t>(next);
      const float share = static_cast<float>(k - bins[a]) / static_cast<float>(bins[b] - bins[a]);
      heights[k] = line[a].z + share * (line[b].z - line[a].z);
    }
  }
}

}  // namespace

std::vector<std::uint8_t> ground_points(const float* points, std::size_t count) {
  std::vector<Cell> cells(count);
  std::vector<Low> lows(static_cast<std::size_t>(kSectors * kBins));
  for (std::size_t n = 0; n < count; ++n) {
    const float x = points[3 * n], y = points[3 * n + 1], z = points[3 * n + 2];
    const float range = std::sqrt(x * x + y * y);
    if (!(range >= kNearM && range < kFarM)) continue;
    const int sector = static_cast<int>((std::atan2(y, x) + kPi) * (kSectors / (2.0F * kPi)));
    Cell& cell = cells[n];
    cell.sector = static_cast<std::int16_t>(std::clamp(sector, 0, kSectors - 1));
    cell.bin = static_cast<std::int16_t>(bin_of(range));
    cell.range = range;
    Low& low = lows[static_cast<std::size_t>(cell.sector * kBins + cell.bin)];
    if (z < low.z) low = {range, z};
  }
  const float level = level_of(lows);
  std::vector<float> heights(lows.size());
  for (int sector = 0; sector < kSectors; ++sector)
    follow(&lows[static_cast<std::size_t>(sector * kBins)], level, &heights[static_cast<std::size_t>(sector * kBins)]);
  std::vector<std::uint8_t> ground(count);
  for (std::size_t n = 0; n < count; ++n) {
    if (cells[n].sector < 0) continue;
    const float height = heights[static_cast<std::size_t>(cells[n].sector * kBins + cells[n].bin)];
    ground[n] = points[3 * n + 2] - height <= kGroundM;
  }
  return ground;
}

}  // namespace lidarcodec
