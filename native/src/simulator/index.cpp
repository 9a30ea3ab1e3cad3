#include "simulator/index.hpp"

#include <algorithm>
#include <cmath>
#include <cstdint>

namespace lidarcodec::sim {

void Index::build(const std::vector<const Object*>& objects, V3 center, double reach, double slack, double seconds) {
  struct Near {
    double distance;
    std::size_t order;
    const Object* object;
  };
  std::vector<Near> nearest;
  for (auto& sector : sectors_) sector.clear();
  for (const Object* object : objects) {
    const double wx = center.x - object->at.x, wy = center.y - object->at.y;
    const double x = object->c * wx + object->s * wy, y = object->c * wy - object->s * wx;
    const double dx = max_of(max_of(object->lo[0] - x, x - object->hi[0]), 0.0);
    const double dy = max_of(max_of(object->lo[1] - y, y - object->hi[1]), 0.0);
    const double moved = (abs_of(object->vx) + abs_of(object->vy)) * seconds;
    const double distance = std::sqrt(dx * dx + dy * dy) - slack - moved;
    if (distance < reach) nearest.push_back({distance, nearest.size(), object});
  }
  // A stable order, independent of the library's sort: ties keep the order of the world's objects.
  std::sort(nearest.begin(), nearest.end(), [](const Near& a, const Near& b) {
    return a.distance != b.distance ? a.distance < b.distance : a.order < b.order;
  });
  for (const Near& near : nearest) {
    const Object& o = *near.object;
    const double wx = o.at.x - center.x, wy = o.at.y - center.y;
    double lo = 0, hi = 4.0, farthest = 0, first = 0;
    for (int k = 0; k < 4; ++k) {
      const double lx = (k & 1) ? o.hi[0] : o.lo[0], ly = (k & 2) ? o.hi[1] : o.lo[1];
      const double x = wx + o.c * lx - o.s * ly, y = wy + o.s * lx + o.c * ly;
      farthest = max_of(farthest, x * x + y * y);
      const double angle = diamond_angle(x, y);
      if (k == 0) {
        first = angle;
        lo = hi = 0;
      } else {
        double delta = angle - first;
        if (delta > 2.0) delta -= 4.0;
        if (delta < -2.0) delta += 4.0;
        lo = min_of(lo, delta);
        hi = max_of(hi, delta);
      }
    }
    // A box at a distance covers less than half the horizon; a nearer one is in all sectors.
    const double moved = (abs_of(o.vx) + abs_of(o.vy)) * seconds + slack;
    const double gap = near.distance + moved;
    if (gap < 2.0 * moved + 0.05 || hi - lo > 1.9) {
      lo = 0, hi = 3.9999;
    } else {
      const double pad = 1.06 * moved / gap + 0.002;
      lo = first + lo - pad;
      hi = first + hi + pad;
    }
    const double from = max_of(near.distance, 0.05), to = std::sqrt(farthest) + moved;
    const double low = o.at.z + o.lo[2] - center.z - 0.25, high = o.at.z + o.hi[2] - center.z + 0.25;
    const Entry entry{static_cast<float>(near.distance), static_cast<float>(min_of(low / from, low / to)),
                      static_cast<float>(max_of(high / from, high / to)), &o};
    const std::int64_t a = floor_of(lo * (kSectors / 4.0)), b = floor_of(hi * (kSectors / 4.0));
    for (std::int64_t k = a; k <= b && k < a + kSectors; ++k)
      sectors_[static_cast<std::size_t>(k & (kSectors - 1))].push_back(entry);
  }
}

void Index::trace(const Ray& ray, double dt, Hit& hit) const {
  const double level = std::sqrt(ray.direction.x * ray.direction.x + ray.direction.y * ray.direction.y);
  const double tangent = ray.direction.z / level;
  const auto sector =
      static_cast<std::size_t>(diamond_angle(ray.direction.x, ray.direction.y) * (kSectors / 4.0)) & (kSectors - 1);
  double reached = hit.t * level;
  for (const Entry& entry : sectors_[sector]) {
    if (entry.distance > reached) break;
    if (tangent < entry.tan_lo || tangent > entry.tan_hi) continue;
    trace_object(*entry.object, ray, dt, hit);
    reached = hit.t * level;
  }
}

}  // namespace lidarcodec::sim
