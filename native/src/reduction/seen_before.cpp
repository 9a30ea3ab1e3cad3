#include "reduction/seen_before.hpp"

#include <algorithm>
#include <cmath>

#include "base/error.hpp"
#include "motion/directions.hpp"

namespace lidarcodec {
namespace {

constexpr float kLengthM = 1.0f / 16'000.0f;

constexpr float kFarthestM = 40.0f;  // further returns may be the first on their surface
constexpr float kReachM = 0.25f,
                kReachPerMetre = 0.008f;  // distance of a neighbour, at most, and what is added with range

// Occupied voxels around the current position: a column of 64 voxels is a word.
constexpr float kVoxelM = 0.15f;
constexpr std::ptrdiff_t kVoxelsAcross = 2 * 272;  // 40.8 m to each side: the farthest return and its reach
constexpr float kOriginM = kVoxelM * (kVoxelsAcross / 2), kLowestM = -kVoxelM * 32;

constexpr std::size_t kSectors = 128;
constexpr std::size_t kRings = 42;                  // of a metre each
constexpr float kStepM = 0.15f, kGradient = 0.12f;  // largest step of the ground, and its largest gradient
constexpr float kGroundHeightM = 0.25f;             // returns less high above the ground count as ground
constexpr std::size_t kNearRings = 12;              // those that give the sensor's height
constexpr float kNone = 1e9f;

class OccupancyGrid {
 public:
  OccupancyGrid() : columns_(static_cast<std::size_t>(kVoxelsAcross * kVoxelsAcross)) {}

  void add(const PastScan& past) {
    const Placed& t = past.placed;
    for (std::size_t i = 0; i < past.scan.size; ++i) {
      const float x = past.scan.xyz[3 * i], y = past.scan.xyz[3 * i + 1], z = past.scan.xyz[3 * i + 2];
      const float px = t[0] * x + t[1] * y + t[2] * z + t[3] + kOriginM;
      const float py = t[4] * x + t[5] * y + t[6] * z + t[7] + kOriginM;
      const float pz = t[8] * x + t[9] * y + t[10] * z + t[11] - kLowestM;
      // Comparisons with NaN are false, so NaN is left out, too.
      if (!(px >= 0.0f && px < 2 * kOriginM && py >= 0.0f && py < 2 * kOriginM && pz >= 0.0f && pz < 64 * kVoxelM))
        continue;
      const auto cx = std::min(static_cast<std::ptrdiff_t>(px / kVoxelM), kVoxelsAcross - 1);
      const auto cy = std::min(static_cast<std::ptrdiff_t>(py / kVoxelM), kVoxelsAcross - 1);
      columns_[static_cast<std::size_t>(cx * kVoxelsAcross + cy)] |= std::uint64_t{1}
                                                                     << std::min(static_cast<int>(pz / kVoxelM), 63);
    }
  }

  // Whether the centre of an occupied voxel lies within `reach`. Points above or below the columns count as seen.
  bool near(float x, float y, float z, float reach) const {
    const float px = x + kOriginM, py = y + kOriginM, pz = z - kLowestM;
    if (pz < 0.0f || pz >= 64 * kVoxelM) return true;
    const auto cx = static_cast<std::ptrdiff_t>(std::floor(px / kVoxelM)),
               cy = static_cast<std::ptrdiff_t>(std::floor(py / kVoxelM));
    if (found(cx, cy, px, py, pz, reach)) return true;
    const auto most = static_cast<std::ptrdiff_t>(reach / kVoxelM) + 1;
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
    if (cx < 0 || cy < 0 || cx >= kVoxelsAcross || cy >= kVoxelsAcross) return false;
    const std::uint64_t column = columns_[static_cast<std::size_t>(cx * kVoxelsAcross + cy)];
    if (column == 0) return false;
    const float dx = (static_cast<float>(cx) + 0.5f) * kVoxelM - px,
                dy = (static_cast<float>(cy) + 0.5f) * kVoxelM - py;
    const float left = reach * reach - dx * dx - dy * dy;
    if (left < 0.0f) return false;
    const float high = std::sqrt(left);
    const int from = std::clamp(static_cast<int>(std::ceil((pz - high) / kVoxelM - 0.5f)), 0, 64);
    const int to = std::clamp(static_cast<int>(std::floor((pz + high) / kVoxelM - 0.5f)), -1, 63);
    if (to < from) return false;
    const std::uint64_t within = (~std::uint64_t{0} >> (63 - (to - from))) << from;
    return (column & within) != 0;
  }

  std::vector<std::uint64_t> columns_;
};

// Turns the lowest return of each ring of a sector into the height of the ground, outwards from `height`.
void follow_ground(std::array<float, kRings>& lowest, float height) {
  float apart = 1.0f;
  for (float& z : lowest) {
    if (z != kNone && std::abs(z - height) <= kStepM + kGradient * apart) {
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
    if (cell[i] >= kRows * width) throw Error(ErrorCode::Section, "a return in a cell beyond the frame");
    const float* t = moved + 12 * (cell[i] % width);
    const float x = static_cast<float>(xyz[3 * i]) * kLengthM, y = static_cast<float>(xyz[3 * i + 1]) * kLengthM,
                z = static_cast<float>(xyz[3 * i + 2]) * kLengthM;
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
      if (n > 0 && cell[n] <= cell[n - 1]) throw Error(ErrorCode::Section, "the cells of returns do not rise");
      const float x = scan.xyz[3 * n], y = scan.xyz[3 * n + 1], z = scan.xyz[3 * n + 2];
      const float away = std::sqrt(x * x + y * y);
      if (!(away < static_cast<float>(kRings)) || !(std::abs(z) < 100.0f)) continue;
      const std::size_t sector = direction_of(azimuth[cell[n] - row * width], aside) * kSectors / kDirections;
      const auto ring = static_cast<std::size_t>(away);
      place[n] = static_cast<std::uint32_t>(sector * kRings + ring);
      lowest[sector][ring] = std::min(lowest[sector][ring], z);
    }
  }
  if (n < scan.size) throw Error(ErrorCode::Section, "a return in a cell beyond the frame");

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
    ground[i] = scan.xyz[3 * i + 2] < lowest[place[i] / kRings][place[i] % kRings] + kGroundHeightM;
  }
  return ground;
}

std::vector<std::uint8_t> unseen(const Scan& scan, const std::uint8_t* ground, const std::vector<PastScan>& past) {
  OccupancyGrid occupied;
  for (const PastScan& one : past) occupied.add(one);
  std::vector<std::uint8_t> result(scan.size);
  for (std::size_t i = 0; i < scan.size; ++i) {
    if (ground[i]) continue;
    const float x = scan.xyz[3 * i], y = scan.xyz[3 * i + 1], z = scan.xyz[3 * i + 2];
    const float away = std::sqrt(x * x + y * y + z * z);
    result[i] = away < kFarthestM && !occupied.near(x, y, z, kReachM + kReachPerMetre * away);
  }
  return result;
}

}  // namespace lidarcodec
