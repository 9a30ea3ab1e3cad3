#include "motion/search.hpp"

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <vector>

#include "motion/views.hpp"

namespace lidarcodec {
namespace {

constexpr std::size_t kEvery = 6;           // slots from candidate to candidate in a row
constexpr std::size_t kTried = 3;            // slots of which the first with a return is a candidate
constexpr std::size_t kPerFacing = 500;      // points of each way to face
constexpr double kCubeM = 0.4;              // of points in a cube of this side one is used
constexpr double kBaseM = 0.3;               // to the neighbours of which a normal is made, at least
constexpr int kRingsAway = 6;                // to those above and below, at most
constexpr double kFlatM = 0.05, kFlatPart = 0.005;  // a neighbour further off the plane: no plane
constexpr std::uint32_t kIterations = 20;
constexpr std::uint32_t kLeastMatched = 150, kLeastMatchedHeld = 40;
constexpr double kHoldTurn = 400, kHoldShift = 0.4;  // as much as points 2 cm off say against 1 mrad and 3 cm
constexpr double kWorstMedianM = 0.2;
constexpr double kFarthestM = 20;

struct Patch {
  Metres at, normal;
};

double length_of(const Metres& a) { return std::sqrt(dot(a, a)); }

// A neighbour in a ring above or below, not so close that the errors of the lasers tilt the plane.
bool far_enough(const View& view, std::size_t row, int by, Angle angle, const Metres& from, Metres& point) {
  for (int k = 1; k <= kRingsAway; ++k) {
    const int ring = static_cast<int>(row) + k * by;
    if (ring < 0 || ring >= static_cast<int>(kRows)) break;
    if (!view.near_angle(static_cast<std::size_t>(ring), angle, point)) continue;
    if (length_of(point - from) > kBaseM) return true;
  }
  return false;
}

// The plane through a point, that of the patch, and its four neighbours; false: there is none.
bool make_patch(const View& view, std::size_t row, std::size_t slot, Patch& patch) {
  Metres left, right, up, down;
  const Angle angle = view.looks(row, slot);
  const double away = length_of(patch.at);
  if (!(away > 1) || away > 80) return false;
  const auto side = static_cast<Angle>(std::clamp(kBaseM / away, 0.006, 0.06) * 683'565'276.0);
  // Most have none: what is known first is asked first.
  const auto close = [&](const Metres& neighbour) { return !(length_of(neighbour - patch.at) > 0.3 + 0.15 * away); };
  if (!view.near_angle(row, angle - side, left) || !close(left) ||
      !view.near_angle(row, angle + side, right) || !close(right) ||
      !far_enough(view, row, -1, angle, patch.at, up) || !close(up) ||
      !far_enough(view, row, 1, angle, patch.at, down) || !close(down)) {
    return false;
  }
  const Metres across = cross(left - right, up - down);
  const double size = length_of(across);
  if (!(size > 1e-9)) return false;
  patch.normal = (1 / size) * across;
  const double flat = kFlatM + kFlatPart * away;
  for (const Metres* neighbour : {&left, &right, &up, &down})
    if (std::abs(dot(patch.normal, *neighbour - patch.at)) > flat) return false;
  if (dot(patch.normal, patch.at) > 0) patch.normal = -1 * patch.normal;
  return std::abs(dot(patch.normal, patch.at)) > 0.03 * away;  // seen too flat
}

constexpr std::size_t kFacings = 5;

// Forward, back, left, right, up.
std::size_t facing(const Metres& n) {
  const double x = std::abs(n.x), y = std::abs(n.y), z = std::abs(n.z);
  if (z >= x && z >= y) return 4;
  return x >= y ? (n.x > 0 ? 0u : 1u) : (n.y > 0 ? 2u : 3u);
}

// Cubes in which there is a point already: near things would otherwise outweigh far ones.
class Cubes {
 public:
  // Two cubes that share a cell are no harm: one of them goes without a point.
  static std::size_t cell(const Metres& p) {
    return (part(p.x) * 73'856'093u ^ part(p.y) * 19'349'663u ^ part(p.z) * 83'492'791u) * 2'654'435'761u >> 16;
  }

  bool taken(std::size_t cell) const { return (cells_[cell / 64] >> cell % 64 & 1u) != 0; }
  void take(std::size_t cell) { cells_[cell / 64] |= std::uint64_t{1} << cell % 64; }

 private:
  // Rounded down, without a call of the library's.
  static std::uint32_t part(double metres) {
    const double cubes = metres / kCubeM;
    const auto whole = static_cast<std::int32_t>(cubes);
    return static_cast<std::uint32_t>(whole - (cubes < whole));
  }

  std::array<std::uint64_t, (1u << 16) / 64> cells_{};
};

// Points that hold the motion in all directions: as many of each way to face as there are, up to a limit.
std::vector<Patch> patches_of(const View& view) {
  std::array<std::vector<Patch>, kFacings> by_facing;
  Cubes cubes;
  Patch patch;
  for (std::size_t row = 1; row + 1 < kRows; ++row) {
    for (std::size_t s = row * 5 % kEvery; s < kSlots; s += kEvery) {
      const std::size_t slot = s + static_cast<std::size_t>(std::countr_zero(view.returns_from(row, s) | 1u << kTried));
      if (slot >= std::min(s + kTried, kSlots)) continue;
      patch.at = view.at(row, slot);
      const std::size_t cell = Cubes::cell(patch.at);
      if (cubes.taken(cell) || !make_patch(view, row, slot, patch)) continue;
      cubes.take(cell);
      by_facing[facing(patch.normal)].push_back(patch);
    }
  }
  std::vector<Patch> chosen;
  for (const std::vector<Patch>& all : by_facing) {
    const std::size_t n = std::min(all.size(), kPerFacing);
    for (std::size_t i = 0; i < n; ++i) chosen.push_back(all[i * all.size() / n]);
  }
  return chosen;
}

struct Rigid {
  std::array<Metres, 3> row{{{1, 0, 0}, {0, 1, 0}, {0, 0, 1}}};
  Metres shift;

  Metres turn(const Metres& p) const { return {dot(row[0], p), dot(row[1], p), dot(row[2], p)}; }
  Metres move(const Metres& p) const { return turn(p) + shift; }

  Rigid inverse() const {
    Rigid back;
    back.row = {{{row[0].x, row[1].x, row[2].x}, {row[0].y, row[1].y, row[2].y}, {row[0].z, row[1].z, row[2].z}}};
    back.shift = -1 * back.turn(shift);
    return back;
  }
};

Rigid rigid_of(const Motion& motion) {
  Rigid rigid;
  constexpr double unit = 1.0 / (1 << 30);
  for (std::size_t i = 0; i < 3; ++i)
    rigid.row[i] = {motion.rotation[3 * i] * unit, motion.rotation[3 * i + 1] * unit, motion.rotation[3 * i + 2] * unit};
  rigid.shift = {motion.translation[0] * kLengthM, motion.translation[1] * kLengthM, motion.translation[2] * kLengthM};
  return rigid;
}

std::int32_t nearest(double value) {
  return std::abs(value) < 2e9 ? static_cast<std::int32_t>(std::floor(value + 0.5)) : 0;
}

Motion motion_of(const Rigid& rigid) {
  Motion motion;
  constexpr double unit = 1 << 30;
  for (std::size_t i = 0; i < 3; ++i) {
    motion.rotation[3 * i] = nearest(rigid.row[i].x * unit);
    motion.rotation[3 * i + 1] = nearest(rigid.row[i].y * unit);
    motion.rotation[3 * i + 2] = nearest(rigid.row[i].z * unit);
  }
  motion.translation = {nearest(rigid.shift.x / kLengthM), nearest(rigid.shift.y / kLengthM),
                        nearest(rigid.shift.z / kLengthM)};
  return motion;
}

// Turned a little more, by the vector w: (1 + [w/2]) (1 - [w/2])^-1, a rotation without sine or cosine.
Rigid turned_by(const Metres& w, const Metres& v, const Rigid& rigid) {
  const Metres h = 0.5 * w;
  const double k = 2 / (1 + dot(h, h));
  const auto turn = [&](const Metres& p) { return p + k * (cross(h, p) + cross(h, cross(h, p))); };
  const Rigid columns = rigid.inverse();  // its rows are the columns of the rotation
  Rigid out;
  const Metres x = turn(columns.row[0]), y = turn(columns.row[1]), z = turn(columns.row[2]);
  out.row = {{{x.x, y.x, z.x}, {x.y, y.y, z.y}, {x.z, y.z, z.z}}};
  out.shift = turn(rigid.shift) + v;
  return out;
}

// Solves h x = b for a symmetric positive h; false: it is not.
bool solve(std::array<std::array<double, 6>, 6> h, std::array<double, 6> b, std::array<double, 6>& x) {
  for (std::size_t i = 0; i < 6; ++i) {
    for (std::size_t j = 0; j <= i; ++j) {
      double sum = h[i][j];
      for (std::size_t k = 0; k < j; ++k) sum -= h[i][k] * h[j][k];
      if (i == j) {
        if (!(sum > 1e-9)) return false;
        h[i][i] = std::sqrt(sum);
      } else {
        h[i][j] = sum / h[j][j];
      }
    }
  }
  for (std::size_t i = 0; i < 6; ++i) {
    for (std::size_t k = 0; k < i; ++k) b[i] -= h[i][k] * b[k];
    b[i] /= h[i][i];
  }
  for (std::size_t i = 6; i-- > 0;) {
    x[i] = b[i];
    for (std::size_t k = i + 1; k < 6; ++k) x[i] -= h[k][i] * x[k];
    x[i] /= h[i][i];
  }
  return true;
}

struct Match {
  Metres at, normal;
  double off;
};

class Search {
 public:
  Search(const View& before, const Beams& beams, const std::vector<Patch>& patches)
      : before_(before), patches_(patches), x_(patches.size()), y_(x_), angle_(patches.size()), looks_(patches.size()) {
    for (std::size_t r = 0; r < kRows; ++r) {
      if (!beams[r].usable) continue;
      rings_.push_back({r, static_cast<double>(beams[r].slope), static_cast<double>(beams[r].sideways * 16) * kLengthM});
    }
    sorted_rings_ = std::is_sorted(rings_.begin(), rings_.end(), [](const Ring& a, const Ring& b) { return a.slope > b.slope; });
  }

  // Points of the frame, moved, beside the closest point that was seen there before.
  void match(const Rigid& rigid, double farthest_m) {
    matches_.clear();
    moved_.clear();
    for (std::size_t i = 0; i < patches_.size(); ++i) {
      const Metres p = rigid.move(patches_[i].at);
      moved_.push_back(p);
      const bool within = std::abs(p.x) < 200 && std::abs(p.y) < 200;
      x_[i] = within ? static_cast<std::int32_t>(p.x / kLengthM) * 16 : 0;
      y_[i] = within ? static_cast<std::int32_t>(p.y / -kLengthM) * 16 : 0;
    }
    land(x_.data(), y_.data(), angle_.data(), x_.size());
    for (std::size_t i = 0; i < moved_.size(); ++i) {
      const double away = static_cast<double>(x_[i]) * (kLengthM / 16 / 1.646760258);
      if (!(away > 0.5)) continue;
      const Metres& p = moved_[i];
      const Metres* closest = nullptr;
      double best = farthest_m * farthest_m;
      Looks& looks = looks_[i];
      const std::size_t ring = ring_of(p.z / away, looks.over);
      for (std::size_t k = ring == 0 ? 0 : ring - 1; k <= ring + 1 && k < rings_.size(); ++k) {
        const auto turned = static_cast<Angle>(static_cast<std::int32_t>(rings_[k].sideways / away * 42'722'830.0));
        const Look& look = looked(looks.at[k % looks.at.size()], rings_[k].row, angle_[i] + turned);
        if (!look.any) continue;
        const Metres apart = p - look.seen;
        const double distance = dot(apart, apart);
        if (distance < best) best = distance, closest = &look.seen;
      }
      if (closest == nullptr) continue;
      const Metres normal = rigid.turn(patches_[i].normal);
      matches_.push_back({p, normal, dot(normal, p - *closest)});
    }
  }

  double median() {
    if (matches_.empty()) return 0;
    sorted_.clear();
    for (const Match& m : matches_) sorted_.push_back(std::abs(m.off));
    const auto middle = sorted_.begin() + static_cast<std::ptrdiff_t>(sorted_.size() / 2);
    std::nth_element(sorted_.begin(), middle, sorted_.end());
    return *middle;
  }

  // A step towards the surface; false: nothing holds it.
  // turned, shifted: how far it is from the start, if that holds it.
  bool step(double scale, bool hold, const Metres& turned, const Metres& shifted, Metres& w, Metres& v) const {
    std::array<std::array<double, 6>, 6> h{};
    std::array<double, 6> b{}, x{};
    for (const Match& m : matches_) {
      const Metres lever = cross(m.at, m.normal);
      const std::array<double, 6> j = {lever.x, lever.y, lever.z, m.normal.x, m.normal.y, m.normal.z};
      const double part = m.off / scale, less = 1 / (1 + part * part), weight = less * less;
      for (std::size_t r = 0; r < 6; ++r) {
        b[r] -= weight * j[r] * m.off;
        for (std::size_t c = 0; c <= r; ++c) h[r][c] += weight * j[r] * j[c];
      }
    }
    const std::array<double, 6> moved = {turned.x, turned.y, turned.z, shifted.x, shifted.y, shifted.z};
    for (std::size_t r = 0; r < 6; ++r) {
      const double weight = !hold ? 0 : r < 3 ? kHoldTurn : kHoldShift;
      h[r][r] += weight + 1e-3;  // nothing moves that nothing holds
      b[r] -= weight * moved[r];
    }
    if (!solve(h, b, x)) return false;
    w = {x[0], x[1], x[2]};
    v = {x[3], x[4], x[5]};
    return true;
  }

  std::size_t matched() const { return matches_.size(); }

 private:
  struct Ring {
    std::size_t row;
    double slope, sideways;  // of its beam; how far its laser sits to the side, m
  };

  // What was seen where a patch was looked for: from step to step it is mostly the same.
  struct Look {
    std::uint32_t where = 0xFFFFFFFF;
    bool any = false;
    Metres seen;
  };
  struct Looks {
    std::array<Look, 3> at;
    std::size_t over = 0;  // ring_of's
  };

  const Look& looked(Look& look, std::size_t row, Angle angle) const {
    const std::size_t slot = before_.slot_of(row, angle);
    const auto where = static_cast<std::uint32_t>(row * kSlots + slot);
    if (look.where != where) {
      look.where = where;
      look.any = before_.near(row, slot, look.seen);
    }
    return look;
  }

  // Index in rings_ of the beam that looks closest to a slope. low: where it was found last, the first not above it.
  std::size_t ring_of(double slope, std::size_t& low) const {
    const double wanted = slope * (1 << 24);
    const std::size_t n = rings_.size();
    const bool still = sorted_rings_ && (low == 0 || rings_[low - 1].slope > wanted) && (low == n || rings_[low].slope <= wanted);
    if (!still) {
      low = 0;
      for (std::size_t high = n; low < high;) {
        const std::size_t middle = (low + high) / 2;
        if (rings_[middle].slope > wanted) {
          low = middle + 1;
        } else {
          high = middle;
        }
      }
    }
    if (low == n) return low == 0 ? 0 : low - 1;
    if (low == 0) return 0;
    const double under = wanted - rings_[low].slope;
    const double over = rings_[low - 1].slope - wanted;
    return over < under ? low - 1 : low;
  }

  const View& before_;
  const std::vector<Patch>& patches_;
  std::vector<std::int32_t> x_, y_;
  std::vector<Angle> angle_;
  std::vector<Looks> looks_;  // of each patch
  std::vector<Ring> rings_;
  bool sorted_rings_ = false;
  std::vector<Metres> moved_;
  std::vector<Match> matches_;
  std::vector<double> sorted_;
};

}  // namespace

FoundMotion find_motion(const RangeHistory& history, const std::uint16_t* ranges, const Columns& columns,
                        const BeamTable& table, const Motion& start, bool hold) {
  const Beams beams = beams_of(table);
  RangeHistory current;
  current.remember(ranges, columns, table.half);
  const View before(history, table, beams), now(current, table, beams);
  const std::vector<Patch> patches = patches_of(now);

  FoundMotion result;
  result.motion = start;
  result.points = static_cast<std::uint32_t>(patches.size());
  const std::uint32_t least = hold ? kLeastMatchedHeld : kLeastMatched;
  if (patches.size() < least) return result;
  Search search(before, beams, patches);
  Rigid rigid = rigid_of(start).inverse();
  double farthest_m = hold ? 0.5 : 2, wide_m = hold ? 0.1 : 1;
  Metres turned, shifted;
  for (result.iterations = 0; result.iterations < kIterations; ++result.iterations) {
    search.match(rigid, farthest_m);
    if (search.matched() < least) break;
    result.median_m = search.median();
    Metres w, v;
    if (!search.step(std::max({0.03, 3 * result.median_m, wide_m}), hold, turned, shifted, w, v)) break;
    if (!(dot(w, w) < 1 && dot(v, v) < kFarthestM * kFarthestM)) break;
    rigid = turned_by(w, v, rigid);
    turned = turned + w;
    shifted = shifted + v;
    farthest_m = std::max(0.5, 0.8 * farthest_m);
    wide_m *= 0.7;
    if (result.iterations >= 4 && dot(w, w) < 1e-10 && dot(v, v) < 1e-6) break;
  }
  result.matched = static_cast<std::uint32_t>(search.matched());
  const Rigid back = rigid.inverse();  // of a rotation: a start that is none is not found
  if (result.matched < least || !(result.median_m < kWorstMedianM) || !(length_of(back.shift) < kFarthestM) ||
      !(std::abs(dot(back.row[0], back.row[0]) - 1) < 1e-6 && std::abs(dot(back.row[1], back.row[1]) - 1) < 1e-6))
    return result;
  result.motion = motion_of(back);
  result.found = true;
  return result;
}

}  // namespace lidarcodec
