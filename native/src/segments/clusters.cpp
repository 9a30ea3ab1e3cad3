#include "segments/clusters.hpp"

#include <algorithm>
#include <cmath>
#include <numeric>

namespace lidarcodec {
namespace {

constexpr float kPi = 3.14159265F;
constexpr float kSteep = 0.17632698F;  // tangent of 10 degrees, as in the paper
constexpr float kCloseM = 0.3F;        // so near by, noise of the ranges says more than the angle
constexpr float kApartM = 0.6F;        // farther apart nothing is one object; more for each metre of range
constexpr float kApartShare = 0.015F;
constexpr std::size_t kRowsBelow = 4;

struct Return {
  float azimuth;
  std::uint32_t point;
};

class Forest {
 public:
  explicit Forest(std::size_t count) : parent_(count) { std::iota(parent_.begin(), parent_.end(), 0U); }
  std::uint32_t root(std::uint32_t n) {
    while (parent_[n] != n) n = parent_[n] = parent_[parent_[n]];
    return n;
  }
  void join(std::uint32_t a, std::uint32_t b) {
    a = root(a), b = root(b);
    if (a != b) parent_[std::max(a, b)] = std::min(a, b);  // the first point of an object is its root
  }

 private:
  std::vector<std::uint32_t> parent_;
};

float most_apart(float range) { return kApartM + kApartShare * range; }

// Whether two points lie on one object. With the ranges d >= e and the angle alpha between the beams, the line between
// the points makes the angle beta with the farther beam: tan beta = e sin alpha / (d - e cos alpha).
bool together(const float* p, const float* q) {
  const float x = p[0] - q[0], y = p[1] - q[1], z = p[2] - q[2];
  const float apart = x * x + y * y + z * z;
  if (apart <= kCloseM * kCloseM) return true;
  const float across[3] = {p[1] * q[2] - p[2] * q[1], p[2] * q[0] - p[0] * q[2], p[0] * q[1] - p[1] * q[0]};
  const float dot = p[0] * q[0] + p[1] * q[1] + p[2] * q[2];
  const float far = std::max(p[0] * p[0] + p[1] * p[1] + p[2] * p[2], q[0] * q[0] + q[1] * q[1] + q[2] * q[2]);
  const float apart_most = most_apart(std::sqrt(far));
  if (apart > apart_most * apart_most) return false;
  const float area = std::sqrt(across[0] * across[0] + across[1] * across[1] + across[2] * across[2]);
  return area > kSteep * (far - dot);
}

}  // namespace

std::vector<std::int32_t> cluster_points(const float* points, const std::uint16_t* rows, const std::uint8_t* ground,
                                         std::size_t count) {
  std::vector<std::vector<Return>> image;
  for (std::size_t n = 0; n < count; ++n) {
    const std::size_t row = rows[n];
    if (row >= image.size()) image.resize(row + 1);
    image[row].push_back({std::atan2(points[3 * n + 1], points[3 * n]), static_cast<std::uint32_t>(n)});
  }
  for (auto& row : image)
    std::sort(row.begin(), row.end(), [](const Return& a, const Return& b) {
      return a.azimuth != b.azimuth ? a.azimuth < b.azimuth : a.point < b.point;
    });
  Forest forest(count);
  const auto joined = [&](std::uint32_t a, std::uint32_t b) {
    if (ground[a] || ground[b] || !together(points + 3 * std::size_t{a}, points + 3 * std::size_t{b})) return false;
    forest.join(a, b);
    return true;
  };
  for (std::size_t row = 0; row < image.size(); ++row) {
    const auto& here = image[row];
    if (here.empty()) continue;
    for (std::size_t k = 0; k < here.size(); ++k) joined(here[k].point, here[(k + 1) % here.size()].point);
    std::size_t next[kRowsBelow] = {};  // in each row below: the first return that is not left of this one
    for (const Return& one : here) {
      if (ground[one.point]) continue;
      const float* p = points + 3 * std::size_t{one.point};
      const float range = std::sqrt(p[0] * p[0] + p[1] * p[1]);
      const float reach = most_apart(range) / std::max(range, kApartM);  // as an angle
      for (std::size_t below = 0; below < kRowsBelow && row + 1 + below < image.size(); ++below) {
        const auto& there = image[row + 1 + below];
        if (there.empty()) continue;
        std::size_t& at = next[below];
        while (at < there.size() && there[at].azimuth < one.azimuth) ++at;
        bool found = false;
        for (const std::size_t place : {at % there.size(), (at + there.size() - 1) % there.size()}) {
          float off = std::abs(there[place].azimuth - one.azimuth);
          off = std::min(off, 2.0F * kPi - off);
          if (off <= reach) found |= joined(one.point, there[place].point);
        }
        if (found) break;
      }
    }
  }
  std::vector<std::int32_t> numbers(count, -1);
  std::int32_t clusters = 0;
  for (std::size_t n = 0; n < count; ++n) {
    if (ground[n]) continue;
    const std::uint32_t root = forest.root(static_cast<std::uint32_t>(n));
    numbers[n] = root == n ? clusters++ : numbers[root];
  }
  return numbers;
}

}  // namespace lidarcodec
