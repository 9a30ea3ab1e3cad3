#include "motion/surface_points.hpp"

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>

namespace lidarcodec {
namespace {

constexpr std::size_t kStride = 6;      // slots from candidate to candidate in a row
constexpr std::size_t kTried = 3;       // slots of which the first with a return is a candidate
constexpr std::size_t kPerClass = 500;  // points of each class of normals
constexpr double kVoxelM = 0.4;         // of the points in a voxel one is used
constexpr double kBaselineM = 0.3;      // from a point to the neighbours that give its normal, at least
constexpr double kLeastBaselineRad = 0.006, kMostBaselineRad = 0.06;
constexpr int kMostRingsApart = 6;  // from a point to those above and below
constexpr double kNearestM = 1, kFarthestM = 80;
constexpr double kPlaneErrorM = 0.05, kPlaneErrorPart = 0.005;  // a neighbour further off the plane: there is no plane
constexpr double kLeastIncidence = 0.03;                        // sine of the angle between a beam and the plane

// The next return in the rings above (by = -1) or below (by = 1) that is at least the baseline away: with closer ones
// the errors of the lasers would tilt the plane.
bool vertical_neighbour(const View& view, std::size_t row, int by, Angle angle, const Vector3& from, Vector3& point) {
  for (int k = 1; k <= kMostRingsApart; ++k) {
    const int ring = static_cast<int>(row) + k * by;
    if (ring < 0 || ring >= static_cast<int>(kRows)) break;
    if (!view.nearest_by_angle(static_cast<std::size_t>(ring), angle, point)) continue;
    if (norm(point - from) > kBaselineM) return true;
  }
  return false;
}

// Sets the normal of a point from its four neighbours; false: they do not lie on a plane.
bool find_normal(const View& view, std::size_t row, std::size_t slot, SurfacePoint& point) {
  Vector3 left, right, up, down;
  const Angle angle = view.angle_of(row, slot);
  const double away = norm(point.at);
  if (!(away > kNearestM) || away > kFarthestM) return false;
  const auto side = static_cast<Angle>(std::clamp(kBaselineM / away, kLeastBaselineRad, kMostBaselineRad) *
                                       static_cast<double>(kAnglePerRadian));
  // Most points have no normal, so the cheapest tests come first.
  const auto close = [&](const Vector3& neighbour) { return !(norm(neighbour - point.at) > kBaselineM + 0.15 * away); };
  if (!view.nearest_by_angle(row, angle - side, left) || !close(left) ||
      !view.nearest_by_angle(row, angle + side, right) || !close(right) ||
      !vertical_neighbour(view, row, -1, angle, point.at, up) || !close(up) ||
      !vertical_neighbour(view, row, 1, angle, point.at, down) || !close(down)) {
    return false;
  }
  const Vector3 across = cross(left - right, up - down);
  const double size = norm(across);
  if (!(size > 1e-9)) return false;
  point.normal = (1 / size) * across;
  const double most_error = kPlaneErrorM + kPlaneErrorPart * away;
  for (const Vector3* neighbour : {&left, &right, &up, &down})
    if (std::abs(dot(point.normal, *neighbour - point.at)) > most_error) return false;
  if (dot(point.normal, point.at) > 0) point.normal = -1 * point.normal;
  return std::abs(dot(point.normal, point.at)) > kLeastIncidence * away;
}

constexpr std::size_t kClasses = 5;

// Forward, back, left, right, or up and down: the axis that is closest to a normal.
std::size_t class_of(const Vector3& n) {
  const double x = std::abs(n.x), y = std::abs(n.y), z = std::abs(n.z);
  if (z >= x && z >= y) return 4;
  return x >= y ? (n.x > 0 ? 0u : 1u) : (n.y > 0 ? 2u : 3u);
}

// Voxels that have a point already: without them near surfaces would outweigh far ones.
class VoxelSet {
 public:
  // The spatial hash of Teschner et al., "Optimized spatial hashing for collision detection of deformable objects"
  // (2003), spread over 16 bits by Knuth's multiplicative hash. Two voxels that share a key are no harm: one stays
  // without a point.
  static std::size_t key(const Vector3& p) {
    constexpr std::uint32_t kX = 73'856'093, kY = 19'349'663, kZ = 83'492'791;
    constexpr std::uint32_t kGolden = 2'654'435'761;  // 2^32 divided by the golden ratio
    return (index(p.x) * kX ^ index(p.y) * kY ^ index(p.z) * kZ) * kGolden >> 16;
  }

  bool has(std::size_t key) const { return (keys_[key / 64] >> key % 64 & 1u) != 0; }
  void add(std::size_t key) { keys_[key / 64] |= std::uint64_t{1} << key % 64; }

 private:
  // Rounded down, without a call of std::floor.
  static std::uint32_t index(double metres) {
    const double voxels = metres / kVoxelM;
    const auto whole = static_cast<std::int32_t>(voxels);
    return static_cast<std::uint32_t>(whole - (voxels < whole));
  }

  std::array<std::uint64_t, (1u << 16) / 64> keys_{};
};

}  // namespace

std::vector<SurfacePoint> surface_points(const View& view) {
  std::array<std::vector<SurfacePoint>, kClasses> by_class;
  VoxelSet voxels;
  SurfacePoint point;
  for (std::size_t row = 1; row + 1 < kRows; ++row) {
    for (std::size_t s = row * 5 % kStride; s < kSlots; s += kStride) {
      const std::size_t slot = s + static_cast<std::size_t>(std::countr_zero(view.returns_from(row, s) | 1u << kTried));
      if (slot >= std::min(s + kTried, kSlots)) continue;
      point.at = view.at(row, slot);
      const std::size_t key = VoxelSet::key(point.at);
      if (voxels.has(key) || !find_normal(view, row, slot, point)) continue;
      voxels.add(key);
      by_class[class_of(point.normal)].push_back(point);
    }
  }
  std::vector<SurfacePoint> chosen;
  for (const std::vector<SurfacePoint>& all : by_class) {
    const std::size_t n = std::min(all.size(), kPerClass);
    for (std::size_t i = 0; i < n; ++i) chosen.push_back(all[i * all.size() / n]);
  }
  return chosen;
}

}  // namespace lidarcodec
