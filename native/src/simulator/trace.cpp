#include <limits>

#include "simulator/facade.hpp"
#include "simulator/scene.hpp"

namespace lidarcodec::sim {
namespace {

constexpr double kFar = std::numeric_limits<double>::infinity();
constexpr double kBeamSpread = 0.002;  // divergence of a beam, radians

double luck_of(const LocalRay& r, std::uint32_t purpose) { return unit32(cell_hash(r.luck, r.id, purpose, 0)); }

void accept(const LocalRay& r, Hit& hit, double t, double cosine, Material m) {
  hit.t = t;
  hit.cosine = cosine;
  hit.material = m;
  hit.albedo = (m == Material::CarPaint || m == Material::Cloth || m == Material::Painted) ? r.paint : -1.0;
  hit.rough_m = 0;
  hit.id = r.id;
  hit.local = r.o + r.d * t;
}

// The part of the ray inside a half space `value + t * gradient >= 0`; false if there is none.
struct Span {
  double in = 0, out = kFar;
  int face = -1;
  bool cut(double value, double gradient, int plane) {
    if (gradient == 0) return value >= 0;
    const double t = -value / gradient;
    if (gradient > 0) {
      if (t > in) in = t, face = plane;
    } else if (t < out) {
      out = t;
    }
    return in < out;
  }
};

// The pane of a car: the beam passes, is lost, or returns (false). Some patches of it always pass beams.
bool glass_eats(const LocalRay& r, Hit& hit, double t) {
  const V3 p = r.o + r.d * t;
  const double luck = luck_of(r, 11);
  const bool clear = unit32(cell_hash(r.id, floor_of(p.x * 2.5), floor_of((p.y + p.z) * 2.5), 12)) < 0.16;
  if (luck < (clear ? 0.75 : 0.02)) return true;
  if (luck < 0.97) {
    accept(r, hit, t, 1.0, Material::Nothing);
    return true;
  }
  return false;
}

void trace_taper(const Part& p, const LocalRay& r, Hit& hit) {
  const float* a = p.a;
  const double z0 = a[4];
  const double rise = 1.0 / (static_cast<double>(a[9]) - z0);
  const double kx0 = (static_cast<double>(a[5]) - a[0]) * rise, kx1 = (static_cast<double>(a[6]) - a[1]) * rise;
  const double ky0 = (static_cast<double>(a[7]) - a[2]) * rise, ky1 = (static_cast<double>(a[8]) - a[3]) * rise;
  const double h = r.o.z - z0;
  Span span;
  span.out = hit.t;
  if (!span.cut(h, r.d.z, 4) || !span.cut(a[9] - r.o.z, -r.d.z, 5) ||
      !span.cut(r.o.x - a[0] - kx0 * h, r.d.x - kx0 * r.d.z, 0) ||
      !span.cut(a[1] + kx1 * h - r.o.x, kx1 * r.d.z - r.d.x, 1) ||
      !span.cut(r.o.y - a[2] - ky0 * h, r.d.y - ky0 * r.d.z, 2) ||
      !span.cut(a[3] + ky1 * h - r.o.y, ky1 * r.d.z - r.d.y, 3) || span.face < 0)
    return;
  double gradient = 0, k = 0;
  switch (span.face) {
    case 0:
      gradient = r.d.x - kx0 * r.d.z, k = kx0;
      break;
    case 1:
      gradient = kx1 * r.d.z - r.d.x, k = kx1;
      break;
    case 2:
      gradient = r.d.y - ky0 * r.d.z, k = ky0;
      break;
    case 3:
      gradient = ky1 * r.d.z - r.d.y, k = ky1;
      break;
    default:
      gradient = r.d.z;
  }
  Material m = p.material;
  if (m == Material::Cabin) {
    if (span.face >= 4)
      m = Material::CarPaint;
    else if (glass_eats(r, hit, span.in))
      return;
  }
  accept(r, hit, span.in, abs_of(gradient) / std::sqrt(1.0 + k * k), m);
}

// Where a ray is inside a circle of radius `radius` around the origin of a plane; false if never.
bool circle_span(double ox, double oy, double dx, double dy, double radius, double& in, double& out) {
  const double a = dx * dx + dy * dy;
  const double b = ox * dx + oy * dy;
  const double c = ox * ox + oy * oy - radius * radius;
  const double disc = b * b - a * c;
  if (disc <= 0 || a < 1e-12) return false;
  const double root = std::sqrt(disc);
  in = (-b - root) / a;
  out = (-b + root) / a;
  return true;
}

void trace_cylinder(const Part& p, const LocalRay& r, Hit& hit) {
  const float* a = p.a;
  double in = 0, out = 0;
  const double ox = r.o.x - a[0], oy = r.o.y - a[1];
  if (!circle_span(ox, oy, r.d.x, r.d.y, a[2], in, out)) return;
  Span span;
  span.out = min_of(out, hit.t);
  if (!span.cut(r.o.z - a[3], r.d.z, 4) || !span.cut(a[4] - r.o.z, -r.d.z, 5)) return;
  if (in > span.in) span.in = in, span.face = 0;
  if (span.in >= span.out || span.face < 0) return;
  const double t = span.in;
  const double cosine = span.face == 0 ? -((ox + t * r.d.x) * r.d.x + (oy + t * r.d.y) * r.d.y) / a[2] : r.d.z;
  accept(r, hit, t, abs_of(cosine), p.material);
}

void trace_wheel(const Part& p, const LocalRay& r, Hit& hit) {
  const float* a = p.a;
  double in = 0, out = 0;
  const double ox = r.o.x - a[0], oz = r.o.z - a[1];
  if (!circle_span(ox, oz, r.d.x, r.d.z, a[2], in, out)) return;
  Span span;
  span.out = min_of(out, hit.t);
  if (!span.cut(r.o.y - a[3], r.d.y, 2) || !span.cut(a[4] - r.o.y, -r.d.y, 3)) return;
  if (in > span.in) span.in = in, span.face = 0;
  if (span.in >= span.out || span.face < 0) return;
  const double t = span.in;
  if (span.face == 0)
    return accept(r, hit, t, abs_of((ox + t * r.d.x) * r.d.x + (oz + t * r.d.z) * r.d.z) / a[2], p.material);
  const double x = ox + t * r.d.x, z = oz + t * r.d.z;  // the rim is bright, the tyre dark
  accept(r, hit, t, abs_of(r.d.y), x * x + z * z < 0.4 * a[2] * a[2] ? Material::Metal : p.material);
}

void trace_ellipsoid(const Part& p, const LocalRay& r, Hit& hit) {
  const float* a = p.a;
  const V3 o{(r.o.x - a[0]) / a[3], (r.o.y - a[1]) / a[4], (r.o.z - a[2]) / a[5]};
  const V3 d{r.d.x / a[3], r.d.y / a[4], r.d.z / a[5]};
  const double dd = dot(d, d), od = dot(o, d);
  const double disc = od * od - dd * (dot(o, o) - 1.0);
  if (disc <= 0) return;
  const double t = (-od - std::sqrt(disc)) / dd;
  if (t <= 0 || t >= hit.t) return;
  const V3 q = o + d * t;
  const V3 n{q.x / a[3], q.y / a[4], q.z / a[5]};
  accept(r, hit, t, abs_of(dot(n, r.d)) / std::sqrt(dot(n, n)), p.material);
}

// Leaves: cells of one or two decimetres hold a leaf or none, more often in clumps and below the outer shell. The cells
// of a tree are the same for all beams; how deep a beam gets varies, as in a real crown.
template <typename Inside>
void walk_leaves(const LocalRay& r, Hit& hit, double in, double out, double density, double cell,
                 const Inside& inside) {
  const double step = cell * 0.92;
  const double scale = 1.0 / cell;
  double t = in + step * luck_of(r, 21);
  const double fill = density * (1.0 + 0.5 * kBeamSpread * (in + out) * 0.5 * scale);
  for (; t < out; t += step) {
    const V3 p = r.o + r.d * t;
    const std::int64_t x = floor_of(p.x * scale), y = floor_of(p.y * scale), z = floor_of(p.z * scale);
    const double clump = unit32(cell_hash(r.id ^ 0x51u, x >> 2, y >> 2, z >> 2));
    const double weight = inside(p, clump);
    if (weight <= 0) continue;
    const std::uint32_t leaf = cell_hash(r.id, x, y, z);
    if (unit32(leaf) >= fill * weight * (0.15 + 1.7 * clump * clump)) continue;
    const double at = t + cell * (unit32(leaf * 0x9E3779B1u) - 0.5) * 0.8;
    if (at <= 0 || at >= hit.t) return;
    accept(r, hit, at, 0.35 + 0.65 * unit32(leaf * 0x85EBCA6Bu), Material::Leaf);
    return;
  }
}

void trace_leaves(const Part& p, const LocalRay& r, Hit& hit) {
  const float* a = p.a;
  const V3 inverse{1.0 / a[3], 1.0 / a[4], 1.0 / a[5]};
  const V3 o{(r.o.x - a[0]) * inverse.x, (r.o.y - a[1]) * inverse.y, (r.o.z - a[2]) * inverse.z};
  const V3 d{r.d.x * inverse.x, r.d.y * inverse.y, r.d.z * inverse.z};
  const double dd = dot(d, d), od = dot(o, d);
  const double disc = od * od - dd * (dot(o, o) - 1.0);
  if (disc <= 0) return;
  const double root = std::sqrt(disc);
  const double in = max_of(0.0, (-od - root) / dd), out = min_of(hit.t, (-od + root) / dd);
  walk_leaves(r, hit, in, out, a[6], a[7], [&](const V3& q, double clump) {
    const V3 u{(q.x - a[0]) * inverse.x, (q.y - a[1]) * inverse.y, (q.z - a[2]) * inverse.z};
    // Open inside, and dense below an irregular outline.
    const double radius = dot(u, u) + 0.75 * (1.0 - clump);
    return radius > 0.8 ? (1.0 - radius) * 5.0 : 0.3 + radius;
  });
}

void trace_leaf_box(const Part& p, const LocalRay& r, Hit& hit) {
  const float* a = p.a;
  Span span;
  span.out = hit.t;
  if (!span.cut(r.o.x - a[0], r.d.x, 0) || !span.cut(a[1] - r.o.x, -r.d.x, 1) || !span.cut(r.o.y - a[2], r.d.y, 2) ||
      !span.cut(a[3] - r.o.y, -r.d.y, 3) || !span.cut(r.o.z - a[4], r.d.z, 4) || !span.cut(a[5] - r.o.z, -r.d.z, 5))
    return;
  walk_leaves(r, hit, span.in, span.out, a[6], a[7], [&](const V3& q, double) {
    const double edge = min_of(min_of(q.y - a[2], a[3] - q.y), a[5] - q.z);  // irregular in the outer 8 cm
    return edge < 0.08 ? 0.25 : 1.0;
  });
}

void trace_fence(const Part& p, const LocalRay& r, Hit& hit) {
  const float* a = p.a;
  if (r.d.y == 0) return;
  const double t = (a[2] - r.o.y) / r.d.y;
  if (t <= 0 || t >= hit.t) return;
  const double x = r.o.x + t * r.d.x, z = r.o.z + t * r.d.z;
  if (x < a[0] || x > a[1] || z < a[3] || z > a[4]) return;
  const double height = static_cast<double>(a[4]) - a[3];
  const double level = (z - a[3]) / height;
  const double post = fraction_of((x - a[0]) / 2.4) * 2.4;
  const bool rail = abs_of(level - 0.12) < 0.035 || abs_of(level - 0.92) < 0.035;
  const double picket = fraction_of((x - a[0]) / a[5]);
  const double blur = kBeamSpread * t / a[5];  // far away a beam always hits a picket
  if (post > 0.09 && !rail && picket > a[6] + 0.5 * blur * luck_of(r, 31)) return;
  accept(r, hit, t, abs_of(r.d.y), p.material);
}

}  // namespace

void trace_object(const Object& object, const Ray& ray, double dt, Hit& hit) {
  LocalRay r;
  const double wx = ray.origin.x - object.at.x - object.vx * dt;
  const double wy = ray.origin.y - object.at.y - object.vy * dt;
  r.o = {object.c * wx + object.s * wy, object.c * wy - object.s * wx, ray.origin.z - object.at.z};
  r.d = {object.c * ray.direction.x + object.s * ray.direction.y,
         object.c * ray.direction.y - object.s * ray.direction.x, ray.direction.z};
  r.luck = static_cast<std::uint32_t>(ray.luck);
  r.id = object.id;
  r.paint = object.paint;
  // Avoids divisions by zero for directions along an axis.
  const V3 inverse{1.0 / (r.d.x == 0 ? 1e-12 : r.d.x), 1.0 / (r.d.y == 0 ? 1e-12 : r.d.y),
                   1.0 / (r.d.z == 0 ? 1e-12 : r.d.z)};
  const auto misses = [&](const float* lo, const float* hi) {
    const double x0 = (lo[0] - r.o.x) * inverse.x, x1 = (hi[0] - r.o.x) * inverse.x;
    const double y0 = (lo[1] - r.o.y) * inverse.y, y1 = (hi[1] - r.o.y) * inverse.y;
    const double z0 = (lo[2] - r.o.z) * inverse.z, z1 = (hi[2] - r.o.z) * inverse.z;
    const double in = max_of(max_of(min_of(x0, x1), min_of(y0, y1)), max_of(min_of(z0, z1), 0.0));
    const double out = min_of(min_of(max_of(x0, x1), max_of(y0, y1)), min_of(max_of(z0, z1), hit.t));
    return in > out;
  };
  if (misses(object.lo, object.hi)) return;
  const double before = hit.t;
  for (std::uint32_t i = 0; i < object.part_count; ++i) {
    const Part& p = object.parts[i];
    if (object.part_count > 1 && misses(p.lo, p.hi)) continue;
    switch (p.shape) {
      case Shape::Taper:
        trace_taper(p, r, hit);
        break;
      case Shape::Cylinder:
        trace_cylinder(p, r, hit);
        break;
      case Shape::Wheel:
        trace_wheel(p, r, hit);
        break;
      case Shape::Ellipsoid:
        trace_ellipsoid(p, r, hit);
        break;
      case Shape::Leaves:
        trace_leaves(p, r, hit);
        break;
      case Shape::LeafBox:
        trace_leaf_box(p, r, hit);
        break;
      case Shape::Facade:
        trace_facade(p, r, hit);
        break;
      case Shape::Fence:
        trace_fence(p, r, hit);
        break;
    }
  }
  if (hit.t < before) hit.label = object.label;
}

}  // namespace lidarcodec::sim
