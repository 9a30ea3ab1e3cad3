#include "motion/registration.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <vector>

#include "motion/rigid.hpp"
#include "motion/surface_points.hpp"
#include "motion/views.hpp"

namespace lidarcodec {
namespace {

constexpr std::uint32_t kMostIterations = 20, kLeastIterations = 4;
constexpr double kConvergedRotation = 1e-10, kConvergedShift = 1e-6;  // squares of a step: 0.01 mrad, 1 mm
constexpr std::uint32_t kLeastMatched = 150, kLeastMatchedNearStart = 40;
// Weights of the prior: a point that is 2 cm off weighs as much as 1 mrad, and as 3 cm.
constexpr double kPriorRotation = 400, kPriorTranslation = 0.4;
constexpr double kDamping = 1e-3;  // added to the diagonal: a direction that no point determines does not move
constexpr double kWorstMedianM = 0.2;
constexpr double kFarthestM = 20;  // of a motion within a turn
constexpr double kFarthestPointM = 200, kNearestPointM = 0.5;
// Largest distance of a match, and scale of the robust weight: where they begin, and where they end.
constexpr double kFirstMatchM = 2, kFirstMatchNearStartM = 0.5, kLastMatchM = 0.5, kMatchShrinks = 0.8;
constexpr double kFirstScaleM = 1, kFirstScaleNearStartM = 0.1, kLastScaleM = 0.03, kScaleShrinks = 0.7;

// to_polar takes lengths in sixteenths of their unit, and an offset over a distance becomes an angle in the same way.
constexpr int kSubsteps = 16;
constexpr auto kAnglePerSubstep = static_cast<double>((kAnglePerRadian + kSubsteps / 2) / kSubsteps);

// The weight of Geman and McClure's estimator (1987), in Zhang's form ("Parameter estimation techniques", 1997, table
// 1).
double robust_weight(double residual, double scale) {
  const double part = residual / scale, less = 1 / (1 + part * part);
  return less * less;
}

struct Match {
  Vector3 at, normal;
  double residual;  // signed distance from the plane
};

class Registration {
 public:
  Registration(const View& before, const Beams& beams, const std::vector<SurfacePoint>& points)
      : before_(before), points_(points), x_(points.size()), y_(x_), angle_(points.size()), cached_(points.size()) {
    for (std::size_t r = 0; r < kRows; ++r) {
      if (!beams[r].usable) continue;
      rings_.push_back({r, static_cast<double>(beams[r].tan_elevation),
                        static_cast<double>(beams[r].horizontal_offset * kSubsteps) * kLengthM});
    }
    sorted_rings_ = std::is_sorted(rings_.begin(), rings_.end(),
                                   [](const Ring& a, const Ring& b) { return a.tan_elevation > b.tan_elevation; });
  }

  // Associates each point, moved, with the closest return of the history in its direction.
  void match(const Rigid& rigid, double farthest_m) {
    matches_.clear();
    moved_.clear();
    for (std::size_t i = 0; i < points_.size(); ++i) {
      const Vector3 p = rigid.transform(points_[i].at);
      moved_.push_back(p);
      const bool within = std::abs(p.x) < kFarthestPointM && std::abs(p.y) < kFarthestPointM;
      x_[i] = within ? static_cast<std::int32_t>(p.x / kLengthM) * kSubsteps : 0;
      y_[i] = within ? static_cast<std::int32_t>(p.y / -kLengthM) * kSubsteps : 0;
    }
    to_polar(x_.data(), y_.data(), angle_.data(), x_.size());
    for (std::size_t i = 0; i < moved_.size(); ++i) {
      const double away = static_cast<double>(x_[i]) * (kLengthM / kSubsteps / kCordicGain);
      if (!(away > kNearestPointM)) continue;
      const Vector3& p = moved_[i];
      const Vector3* closest = nullptr;
      double best = farthest_m * farthest_m;
      Cached& cached = cached_[i];
      const std::size_t ring = ring_of(p.z / away, cached.ring);
      for (std::size_t k = ring == 0 ? 0 : ring - 1; k <= ring + 1 && k < rings_.size(); ++k) {
        const auto parallax =
            static_cast<Angle>(static_cast<std::int32_t>(rings_[k].horizontal_offset / away * kAnglePerSubstep));
        const Lookup& lookup = looked_up(cached.at[k % cached.at.size()], rings_[k].row, angle_[i] + parallax);
        if (!lookup.any) continue;
        const Vector3 apart = p - lookup.found;
        const double distance = dot(apart, apart);
        if (distance < best) best = distance, closest = &lookup.found;
      }
      if (closest == nullptr) continue;
      const Vector3 normal = rigid.rotate(points_[i].normal);
      matches_.push_back({p, normal, dot(normal, p - *closest)});
    }
  }

  double median_residual() {
    if (matches_.empty()) return 0;
    sorted_.clear();
    for (const Match& m : matches_) sorted_.push_back(std::abs(m.residual));
    const auto middle = sorted_.begin() + static_cast<std::ptrdiff_t>(sorted_.size() / 2);
    std::nth_element(sorted_.begin(), middle, sorted_.end());
    return *middle;
  }

  // A Gauss-Newton step: rotation vector w and translation v. False: the matches do not determine it.
  // prior: whether the sum of all steps so far, rotated and shifted, is held near 0.
  bool step(double scale, bool prior, const Vector3& rotated, const Vector3& shifted, Vector3& w, Vector3& v) const {
    std::array<std::array<double, 6>, 6> h{};  // J^T W J, lower half
    std::array<double, 6> b{}, x{};            // -J^T W r
    for (const Match& m : matches_) {
      const Vector3 lever = cross(m.at, m.normal);
      const std::array<double, 6> j = {lever.x, lever.y, lever.z, m.normal.x, m.normal.y, m.normal.z};
      const double weight = robust_weight(m.residual, scale);
      for (std::size_t r = 0; r < 6; ++r) {
        b[r] -= weight * j[r] * m.residual;
        for (std::size_t c = 0; c <= r; ++c) h[r][c] += weight * j[r] * j[c];
      }
    }
    const std::array<double, 6> moved = {rotated.x, rotated.y, rotated.z, shifted.x, shifted.y, shifted.z};
    for (std::size_t r = 0; r < 6; ++r) {
      const double weight = !prior ? 0 : r < 3 ? kPriorRotation : kPriorTranslation;
      h[r][r] += weight + kDamping;
      b[r] -= weight * moved[r];
    }
    if (!solve_cholesky(h, b, x)) return false;
    w = {x[0], x[1], x[2]};
    v = {x[3], x[4], x[5]};
    return true;
  }

  std::size_t matched() const { return matches_.size(); }

 private:
  struct Ring {
    std::size_t row;
    double tan_elevation, horizontal_offset;  // of its beam: steps of 2^-24; metres, times kSubsteps
  };

  // The return that was found for a point. From iteration to iteration it is mostly the same, so it is kept.
  struct Lookup {
    std::uint32_t cell = 0xFFFFFFFF;
    bool any = false;
    Vector3 found;
  };
  struct Cached {
    std::array<Lookup, 3> at;
    std::size_t ring = 0;  // ring_of's
  };

  const Lookup& looked_up(Lookup& lookup, std::size_t row, Angle angle) const {
    const std::size_t slot = before_.slot_of(row, angle);
    const auto cell = static_cast<std::uint32_t>(row * kSlots + slot);
    if (lookup.cell != cell) {
      lookup.cell = cell;
      lookup.any = before_.nearest(row, slot, lookup.found);
    }
    return lookup;
  }

  // Index in rings_ of the beam whose elevation is closest to a tangent. low: the first ring that is not above it; the
  // last result is tried first.
  std::size_t ring_of(double tangent, std::size_t& low) const {
    const double wanted = tangent * (1 << 24);
    const std::size_t n = rings_.size();
    const bool still = sorted_rings_ && (low == 0 || rings_[low - 1].tan_elevation > wanted) &&
                       (low == n || rings_[low].tan_elevation <= wanted);
    if (!still) {
      low = 0;
      for (std::size_t high = n; low < high;) {
        const std::size_t middle = (low + high) / 2;
        if (rings_[middle].tan_elevation > wanted) {
          low = middle + 1;
        } else {
          high = middle;
        }
      }
    }
    if (low == n) return low == 0 ? 0 : low - 1;
    if (low == 0) return 0;
    const double under = wanted - rings_[low].tan_elevation;
    const double over = rings_[low - 1].tan_elevation - wanted;
    return over < under ? low - 1 : low;
  }

  const View& before_;
  const std::vector<SurfacePoint>& points_;
  std::vector<std::int32_t> x_, y_;
  std::vector<Angle> angle_;
  std::vector<Cached> cached_;  // of each point
  std::vector<Ring> rings_;
  bool sorted_rings_ = false;
  std::vector<Vector3> moved_;
  std::vector<Match> matches_;
  std::vector<double> sorted_;
};

}  // namespace

FoundMotion find_motion(const RangeHistory& history, const std::uint16_t* ranges, const Columns& columns,
                        const BeamTable& table, const Motion& start, bool near_start) {
  const Beams beams = beams_of(table);
  RangeHistory current;
  current.remember(ranges, columns, table.half);
  const View before(history, table, beams), now(current, table, beams);
  const std::vector<SurfacePoint> points = surface_points(now);

  FoundMotion result;
  result.motion = start;
  result.points = static_cast<std::uint32_t>(points.size());
  const std::uint32_t least = near_start ? kLeastMatchedNearStart : kLeastMatched;
  if (points.size() < least) return result;
  Registration registration(before, beams, points);
  Rigid rigid = rigid_of(start).inverse();  // T_previous_current: the current points move to the history
  double farthest_m = near_start ? kFirstMatchNearStartM : kFirstMatchM;
  double scale_m = near_start ? kFirstScaleNearStartM : kFirstScaleM;
  Vector3 rotated, shifted;
  for (result.iterations = 0; result.iterations < kMostIterations; ++result.iterations) {
    registration.match(rigid, farthest_m);
    if (registration.matched() < least) break;
    result.median_m = registration.median_residual();
    Vector3 w, v;
    if (!registration.step(std::max({kLastScaleM, 3 * result.median_m, scale_m}), near_start, rotated, shifted, w, v))
      break;
    if (!(dot(w, w) < 1 && dot(v, v) < kFarthestM * kFarthestM)) break;
    rigid = updated(rigid, w, v);
    rotated = rotated + w;
    shifted = shifted + v;
    farthest_m = std::max(kLastMatchM, kMatchShrinks * farthest_m);
    scale_m *= kScaleShrinks;
    if (result.iterations >= kLeastIterations && dot(w, w) < kConvergedRotation && dot(v, v) < kConvergedShift) break;
  }
  result.matched = static_cast<std::uint32_t>(registration.matched());
  const Rigid back = rigid.inverse();
  // A start whose matrix is not a rotation gives no rotation either.
  if (result.matched < least || !(result.median_m < kWorstMedianM) || !(norm(back.translation) < kFarthestM) ||
      !is_orthonormal(back))
    return result;
  result.motion = motion_of(back);
  result.found = true;
  return result;
}

}  // namespace lidarcodec
