#include "reduction/seen_before.hpp"

#include <algorithm>
#include <cmath>

#include "motion/directions.hpp"
#include "base/error.hpp"

namespace lidarcodec {
namespace {

constexpr float kMetres = 1.0f / 16'000.0f;

constexpr float kFarthest = 40.0f;     // beyond, a return may be new: nothing is said of it
constexpr float kReach = 0.25f, kReachSlope = 0.008f;  // how far off its neighbour may be, and more with range

// Columns of occupied cells, 64 of them one above the other in a word, around the sensor of now.
constexpr float kCell = 0.15f;
constexpr std::ptrdiff_t kAcross = 2 * 272;  // 40.8 m each way: as far as the reach of the farthest return
constexpr float kOrigin = kCell * (kAcross / 2), kLowest = -kCell * 32;

constexpr std::size_t kSectors = 128;
constexpr std::size_t kRings = 42;               // of a metre each
constexpr float kStep = 0.15f, kSlope = 0.12f;   // what ground may rise or fall from one place to the next, and a metre
constexpr float kLow = 0.25f;                    // above the ground this counts as ground
constexpr std::size_t kNearRings = 12;           // those that say how high the sensor stands
constexpr float kNone = 1e9f;

class Occupied {
 public:
  Occupied() : columns_(static_cast<std::size_t>(kAcross * kAcross)) {}

  void add(const PastScan& past) {
    const Placed& t = past.placed;
    for (std::size_t i = 0; i < past.scan.size; ++i) {
      const float x = past.scan.xyz[3 * i], y = past.scan.xyz[3 * i + 1], z = past.scan.xyz[3 * i + 2];
      const float px = t[0] * x + t[1] * y + t[2] * z + t[3] + kOrigin;
      const float py = t[4] * x + t[5] * y + t[6] * z + t[7] + kOrigin;
      const float pz = t[8] * x + t[9] * y + t[10] * z + t[11] - kLowest;
      // Written so that what is no number stays out.
      if (!(px >= 0.0f && px < 2 * kOrigin && py >= 0.0f && py < 2 * kOrigin && pz >= 0.0f && pz < 64 * kCell)) continue;
      const auto cx = std::min(static_cast<std::ptrdiff_t>(px / kCell), kAcross - 1);
      const auto cy = std::min(static_cast<std::ptrdiff_t>(py / kCell), kAcross - 1);
      columns_[static_cast<std::size_t>(cx * kAcross + cy)] |= std::uint64_t{1} << std::min(static_cast<int>(pz / kCell), 63);
    }
  }

  // Whether the middle of an occupied cell lies within `reach`. What is higher or lower than the columns counts as seen.
  bool near(float x, float y, float z, float reach) const {
    const float px = x + kOrigin, py = y + kOrigin, pz = z - kLowest;
    if (pz < 0.0f || pz >= 64 * kCell) return true;
    const auto cx = static_cast<std::ptrdiff_t>(std::floor(px / kCell)), cy = static_cast<std::ptrdiff_t>(std::floor(py / kCell));
    if (found(cx, cy, px, py, pz, reach)) return true;
    const auto most = static_cast<std::ptrdiff_t>(reach / kCell) + 1;
    for (std::ptrdiff_t around = 1; around <= most; ++around) {
      for (std::ptrdiff_t d = -around; d <= around; ++d) {
        if (found(cx + d, cy - around, px, py, pz, reach) || found(cx + d, cy + around, px, py, pz, reach)) return true;
      }
      for (std::ptrdiff_t d = 1 - around; d < around; ++d) {
        if (found(cx - around, cy + d, px, py, pz, reach) || found(cx + around, cy + d, px, py, pz, reach)) return true;
      }
    }
    return false;
  }

 private:
  bool found(std::ptrdiff_t cx, std::ptrdiff_t cy, float px, float py, float pz, float reach) const {
    if (cx < 0 || cy < 0 || cx >= kAcross || cy >= kAcross) return false;
    const std::uint64_t column = columns_[static_cast<std::size_t>(cx * kAcross + cy)];
    if (column == 0) return false;
    const float dx = (static_cast<float>(cx) + 0.5f) * kCell - px, dy = (static_cast<float>(cy) + 0.5f) * kCell - py;
    const float left = reach * reach - dx * dx - dy * dy;
    if (left < 0.0f) return false;
    const float high = std::sqrt(left);
    const int from = std::clamp(static_cast<int>(std::ceil((pz - high) / kCell - 0.5f)), 0, 64);
    const int to = std::clamp(static_cast<int>(std::floor((pz + high) / kCell - 0.5f)), -1, 63);
    if (to < from) return false;
    const std::uint64_t within = (~std::uint64_t{0} >> (63 - (to - from))) << from;
    return (column & within) != 0;
  }

  std::vector<std::uint64_t> columns_;
};

// How high the ground is in each ring of a sector, from the lowest return of each; outwards from `height`.
void follow_ground(std::array<float, kRings>& lowest, float height) {
  float apart = 1.0f;
  for (float& z : lowest) {
    if (z != kNone && std::abs(z - height) <= kStep + kSlope * apart) {
      height = z;
      apart = 1.0f;
    } else {
      z = height;
      apart += 1.0f;
    }
  }
}

}  // namespace

std::vector<float> deskewed(const std::int32_t* xyz, const std::uint32_t* cell, std::size_t size, const float* moved,
                            std::size_t width) {
  std::vector<float> points(3 * size);
  for (std::size_t i = 0; i < size; ++i) {
    if (cell[i] >= kRows * width) throw Error(ErrorCode::Section, "a return in a cell that the frame has not");
    const float* t = moved + 12 * (cell[i] % width);
    const float x = static_cast<float>(xyz[3 * i]) * kMetres, y = static_cast<float>(xyz[3 * i + 1]) * kMetres,
                z = static_cast<float>(xyz[3 * i + 2]) * kMetres;
    for (std::size_t axis = 0; axis < 3; ++axis, t += 4) points[3 * i + axis] = t[0] * x + t[1] * y + t[2] * z + t[3];
  }
  return points;
}

std::vector<std::uint8_t> ground_of(const Scan& scan, const std::uint32_t* cell, const Columns& columns,
                                    const BeamTable& table) {
  check_azimuths(columns);
  const std::size_t width = columns.width;
  std::vector<std::array<float, kRings>> lowest(kSectors);
  for (auto& sector : lowest) sector.fill(kNone);
  constexpr std::uint32_t kNowhere = ~std::uint32_t{0};
  std::vector<std::uint32_t> place(scan.size, kNowhere);  // sector * kRings + ring
  std::size_t n = 0;
  for (std::size_t row = 0; row < kRows; ++row) {
    const std::uint16_t* azimuth = columns.azimuth + (table.half[row] ? width : 0);
    const std::uint32_t aside = direction_offset(table.rotation[row]);
    for (const std::size_t end = (row + 1) * width; n < scan.size && cell[n] < end; ++n) {
      if (n > 0 && cell[n] <= cell[n - 1]) throw Error(ErrorCode::Section, "cells of returns do not rise");
      const float x = scan.xyz[3 * n], y = scan.xyz[3 * n + 1], z = scan.xyz[3 * n + 2];
      const float away = std::sqrt(x * x + y * y);
      if (!(away < static_cast<float>(kRings)) || !(std::abs(z) < 100.0f)) continue;
      const std::size_t sector = direction_of(azimuth[cell[n] - row * width], aside) * kSectors / kDirections;
      const auto ring = static_cast<std::size_t>(away);
      place[n] = static_cast<std::uint32_t>(sector * kRings + ring);
      lowest[sector][ring] = std::min(lowest[sector][ring], z);
    }
  }
  if (n < scan.size) throw Error(ErrorCode::Section, "a return in a cell that the frame has not");

  std::vector<float> near;
  for (const auto& sector : lowest) {
    for (std::size_t ring = 3; ring < kNearRings; ++ring)
      if (sector[ring] != kNone) near.push_back(sector[ring]);
  }
  std::vector<std::uint8_t> ground(scan.size);
  if (near.empty()) return ground;
  const auto middle = near.begin() + static_cast<std::ptrdiff_t>(near.size() / 2);
  std::nth_element(near.begin(), middle, near.end());
  for (auto& sector : lowest) follow_ground(sector, *middle);
  for (std::size_t i = 0; i < scan.size; ++i) {
    if (place[i] == kNowhere) continue;
    ground[i] = scan.xyz[3 * i + 2] < lowest[place[i] / kRings][place[i] % kRings] + kLow;
  }
  return ground;
}

std::vector<std::uint8_t> unseen(const Scan& scan, const std::uint8_t* ground, const std::vector<PastScan>& past) {
  Occupied occupied;
  for (const PastScan& one : past) occupied.add(one);
  std::vector<std::uint8_t> result(scan.size);
  for (std::size_t i = 0; i < scan.size; ++i) {
    if (ground[i]) continue;
    const float x = scan.xyz[3 * i], y = scan.xyz[3 * i + 1], z = scan.xyz[3 * i + 2];
    const float away = std::sqrt(x * x + y * y + z * z);
    result[i] = away < kFarthest && !occupied.near(x, y, z, kReach + kReachSlope * away);
  }
  return result;
}

}  // namespace lidarcodec
