#include "plane_motion/finder.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>

#include "motion/rigid.hpp"

namespace lidarcodec {
namespace {

constexpr std::uint32_t kMostIterations = 16, kLeastIterations = 4;
constexpr double kConvergedTurn = 1e-10, kConvergedShift = 1e-6;  // squares of a step: 0.01 mrad, 1 mm
constexpr std::size_t kLeastMatched = 60, kTried = 12'000, kPerClass = 400, kClasses = 5;
constexpr double kNearestM = 1, kFarthestM = 80;
constexpr double kBaseline = 0.02;    // to the neighbours that give a normal, as a share of the distance
constexpr double kNotFlat = 0.004;    // a neighbour further off the plane, as a share: there is no plane
constexpr double kWidestAside = 0.4;  // distance of a neighbour, as a share: beyond is another surface
constexpr double kLeastIncidence = 0.03;
constexpr double kDamping = 1e-3, kWorstMedianM = 0.2;
// Largest distance of a match, and scale of the robust weight: where they begin, without a start and with one, and end.
constexpr double kFirstMatchM = 3, kFirstMatchNearM = 0.7, kLastMatchM = 0.5, kMatchShrinks = 0.8;
constexpr double kFirstScaleM = 1, kFirstScaleNearM = 0.1, kLastScaleM = 0.03, kScaleShrinks = 0.7;
constexpr double kPerAngle = 2 * std::numbers::pi / static_cast<double>(kWholeTurn);

// Points of a frame in metres: x forward, y right, z up.
class Cloud {
 public:
  Cloud(const PlaneBeams& beams, const RangeView& view, double metre)
      : view_(view), columns_(view.columns.at.size()), metre_(metre) {
    for (std::size_t row = 0; row < beams.up.size(); ++row) {
      const double up = beams.up[row] * 4096.0 * kPerAngle, aside = beams.aside[row] * 4096.0 * kPerAngle;
      rows_.push_back({std::cos(up), std::sin(up), std::cos(aside), std::sin(aside), std::tan(up), aside});
    }
    for (const std::int64_t at : view.columns.at) {
      const double angle = static_cast<double>(view.columns.first + static_cast<Angle>(at)) * kPerAngle;
      turned_.push_back({std::cos(angle), std::sin(angle), 0});
    }
  }

  std::size_t rows() const { return rows_.size(); }
  std::size_t columns() const { return columns_; }
  double tan(std::size_t row) const { return rows_[row].tan; }

  // False: no return. column: any; beyond the ends there is none.
  bool at(std::size_t row, std::ptrdiff_t column, Vector3& point) const {
    if (column < 0 || column >= static_cast<std::ptrdiff_t>(columns_)) return false;
    const auto x = static_cast<std::size_t>(column);
    const std::int32_t eighths = view_.eighths[row * columns_ + x];
    if (eighths <= 0) return false;
    const double range = eighths / metre_;
    const Row& of = rows_[row];
    const double ahead = range * of.cos_up * of.cos_aside, beside = range * of.cos_up * of.sin_aside;
    point = {ahead * turned_[x].x - beside * turned_[x].y, ahead * turned_[x].y + beside * turned_[x].x,
             range * of.sin_up};
    return true;
  }

  // Columns from a direction in one row to the same in another one.
  std::ptrdiff_t across(std::size_t from, std::size_t to) const {
    return std::lround((rows_[from].aside - rows_[to].aside) / step());
  }
  double step() const { return static_cast<double>(view_.columns.step()) * kPerAngle; }

  // The point in the direction of another one.
  bool seen_at(const Vector3& towards, Vector3& point) const {
    const double away = std::hypot(towards.x, towards.y), rise = towards.z / std::max(away, 1e-6);
    const auto below = std::partition_point(rows_.begin(), rows_.end(), [&](const Row& of) { return of.tan > rise; });
    auto row = static_cast<std::size_t>(below - rows_.begin());
    if (row == rows_.size() || (row > 0 && rows_[row - 1].tan - rise < rise - rows_[row].tan)) --row;
    const double next =
        row + 1 < rows_.size() ? rows_[row].tan - rows_[row + 1].tan : rows_[row - 1].tan - rows_[row].tan;
    if (std::abs(rise - rows_[row].tan) > next) return false;
    const double angle = std::atan2(towards.y, towards.x) - rows_[row].aside;
    const auto turn = static_cast<Angle>(static_cast<std::int64_t>(angle / kPerAngle));
    const std::int64_t at = static_cast<Angle>(turn - view_.columns.first);
    const std::vector<std::int64_t>& all = view_.columns.at;
    auto column = std::upper_bound(all.begin(), all.end(), at) - all.begin() - 1;
    if (column + 1 < static_cast<std::ptrdiff_t>(columns_) &&
        all[static_cast<std::size_t>(column) + 1] - at < at - all[static_cast<std::size_t>(column)])
      ++column;
    return this->at(row, column, point);
  }

 private:
  struct Row {
    double cos_up, sin_up, cos_aside, sin_aside, tan, aside;
  };
  const RangeView& view_;
  std::size_t columns_;
  double metre_;
  std::vector<Row> rows_;
  std::vector<Vector3> turned_;
};

struct Surface {
  Vector3 at, normal;
};

// The next row at least the baseline away; -1: none.
std::ptrdiff_t row_apart(const Cloud& cloud, std::size_t row, int by) {
  auto other = static_cast<std::ptrdiff_t>(row);
  do {
    other += by;
    if (other < 0 || other >= static_cast<std::ptrdiff_t>(cloud.rows())) return -1;
  } while (std::abs(cloud.tan(static_cast<std::size_t>(other)) - cloud.tan(row)) < kBaseline / 2);
  return other;
}

// Forward, back, left, right, or up and down: the axis that is closest to a normal.
std::size_t class_of(const Vector3& n) {
  const double x = std::abs(n.x), y = std::abs(n.y), z = std::abs(n.z);
  if (z >= x && z >= y) return 4;
  return x >= y ? (n.x > 0 ? 0u : 1u) : (n.y > 0 ? 2u : 3u);
}

// Points on planes, spread over the frame and over the directions in which planes face.
std::vector<Surface> surfaces_of(const Cloud& cloud) {
  std::array<std::vector<Surface>, kClasses> by_class;
  const auto aside = std::max<std::ptrdiff_t>(1, std::lround(kBaseline / cloud.step()));
  const std::size_t stride = std::max<std::size_t>(1, cloud.rows() * cloud.columns() / kTried);
  for (std::size_t row = 0; row < cloud.rows(); ++row) {
    const std::ptrdiff_t above = row_apart(cloud, row, -1), below = row_apart(cloud, row, 1);
    if (above < 0 || below < 0) continue;
    const auto over = static_cast<std::size_t>(above), under = static_cast<std::size_t>(below);
    for (std::size_t x = row * 7 % stride; x < cloud.columns(); x += stride) {
      const auto column = static_cast<std::ptrdiff_t>(x);
      Surface point;
      std::array<Vector3, 4> near;
      if (!cloud.at(row, column, point.at)) continue;
      const double away = norm(point.at);
      if (away < kNearestM || away > kFarthestM) continue;
      if (!cloud.at(row, column - aside, near[0]) || !cloud.at(row, column + aside, near[1]) ||
          !cloud.at(over, column + cloud.across(row, over), near[2]) ||
          !cloud.at(under, column + cloud.across(row, under), near[3]))
        continue;
      const Vector3 facing = cross(near[0] - near[1], near[2] - near[3]);
      const double size = norm(facing);
      if (!(size > 1e-9)) continue;
      point.normal = (1 / size) * facing;
      if (dot(point.normal, point.at) > 0) point.normal = -1 * point.normal;
      if (!(std::abs(dot(point.normal, point.at)) > kLeastIncidence * away)) continue;
      const bool flat = std::all_of(near.begin(), near.end(), [&](const Vector3& one) {
        const Vector3 apart = one - point.at;
        return norm(apart) < kWidestAside * away && std::abs(dot(point.normal, apart)) < kNotFlat * away + 0.03;
      });
      if (flat) by_class[class_of(point.normal)].push_back(point);
    }
  }
  std::vector<Surface> chosen;
  for (const std::vector<Surface>& all : by_class) {
    const std::size_t n = std::min(all.size(), kPerClass);
    for (std::size_t i = 0; i < n; ++i) chosen.push_back(all[i * all.size() / n]);
  }
  return chosen;
}

struct Match {
  Vector3 at, normal;
  double off;  // signed distance from the plane
};

std::vector<Match> matches_of(const std::vector<Surface>& surfaces, const Rigid& rigid, const Cloud& now,
                              double farthest_m) {
  std::vector<Match> matches;
  for (const Surface& one : surfaces) {
    const Vector3 moved = rigid.transform(one.at);
    Vector3 found;
    if (!now.seen_at(moved, found)) continue;
    const Vector3 normal = rigid.rotate(one.normal);
    const Vector3 apart = moved - found;
    const double off = dot(normal, apart);
    if (std::abs(off) < farthest_m && norm(apart) < 4 * farthest_m) matches.push_back({moved, normal, off});
  }
  return matches;
}

// A Gauss-Newton step with the weights of Geman and McClure's estimator. False: the matches do not determine it.
bool step_of(const std::vector<Match>& matches, double scale, Vector3& turn, Vector3& shift) {
  std::array<std::array<double, 6>, 6> h{};  // J^T W J, lower half
  std::array<double, 6> b{}, x{};
  for (const Match& m : matches) {
    const Vector3 lever = cross(m.at, m.normal);
    const std::array<double, 6> j = {lever.x, lever.y, lever.z, m.normal.x, m.normal.y, m.normal.z};
    const double part = m.off / scale, less = 1 / (1 + part * part), weight = less * less;
    for (std::size_t r = 0; r < 6; ++r) {
      b[r] -= weight * j[r] * m.off;
      for (std::size_t c = 0; c <= r; ++c) h[r][c] += weight * j[r] * j[c];
    }
  }
  for (std::size_t r = 0; r < 6; ++r) h[r][r] += kDamping;
  if (!solve_cholesky(h, b, x)) return false;
  turn = {x[0], x[1], x[2]};
  shift = {x[3], x[4], x[5]};
  return true;
}

double median_of(const std::vector<Match>& matches) {
  std::vector<double> off;
  for (const Match& m : matches) off.push_back(std::abs(m.off));
  const auto middle = off.begin() + static_cast<std::ptrdiff_t>(off.size() / 2);
  std::nth_element(off.begin(), middle, off.end());
  return *middle;
}

Rigid rigid_of(const PlaneMotion& motion, double metre) {
  Rigid rigid;
  const std::array<std::int64_t, 9> turn = motion.rotation();
  constexpr double unit = 1.0 / (1 << 24);
  for (std::size_t i = 0; i < 3; ++i)
    rigid.row[i] = {static_cast<double>(turn[3 * i]) * unit, static_cast<double>(turn[3 * i + 1]) * unit,
                    static_cast<double>(turn[3 * i + 2]) * unit};
  rigid.translation = {motion.shift[0] / metre, motion.shift[1] / metre, motion.shift[2] / metre};
  return rigid;
}

std::optional<PlaneMotion> motion_of(const Rigid& rigid, double metre) {
  const auto& m = rigid.row;
  const double scale = 1 + m[0].x + m[1].y + m[2].z;
  if (!(scale > 1)) return std::nullopt;
  const std::array<double, 6> parts = {(m[2].y - m[1].z) / scale * (1 << 18), (m[0].z - m[2].x) / scale * (1 << 18),
                                       (m[1].x - m[0].y) / scale * (1 << 18), rigid.translation.x * metre,
                                       rigid.translation.y * metre,           rigid.translation.z * metre};
  PlaneMotion motion;
  for (std::size_t i = 0; i < 3; ++i) {
    if (!(std::abs(parts[i]) < PlaneMotion::kMostTurn && std::abs(parts[3 + i]) < PlaneMotion::kMostShift))
      return std::nullopt;
    motion.turn[i] = static_cast<std::int32_t>(std::lround(parts[i]));
    motion.shift[i] = static_cast<std::int32_t>(std::lround(parts[3 + i]));
  }
  return motion;
}

}  // namespace

std::optional<PlaneMotion> find_motion(const PlaneBeams& beams, const RangeView& before, const RangeView& now,
                                       double metre, const std::optional<PlaneMotion>& start) {
  const Cloud old(beams, before, metre), fresh(beams, now, metre);
  const std::vector<Surface> surfaces = surfaces_of(old);
  Rigid rigid = start ? rigid_of(*start, metre) : Rigid();
  double match_m = start ? kFirstMatchNearM : kFirstMatchM, scale = start ? kFirstScaleNearM : kFirstScaleM;
  std::vector<Match> matches;
  for (std::uint32_t i = 0; i < kMostIterations; ++i) {
    matches = matches_of(surfaces, rigid, fresh, match_m);
    Vector3 turn, shift;
    if (matches.size() < kLeastMatched || !step_of(matches, scale, turn, shift)) return std::nullopt;
    rigid = updated(rigid, turn, shift);
    const bool still = dot(turn, turn) < kConvergedTurn && dot(shift, shift) < kConvergedShift;
    if (still && i >= kLeastIterations && scale <= kLastScaleM) break;
    match_m = std::max(kLastMatchM, match_m * kMatchShrinks);
    scale = std::max(kLastScaleM, scale * kScaleShrinks);
  }
  if (median_of(matches) > kWorstMedianM) return std::nullopt;
  return motion_of(rigid, metre);
}

}  // namespace lidarcodec
