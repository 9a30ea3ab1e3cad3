#include "simulator/facade.hpp"

namespace lidarcodec::sim {
namespace {

// An opening in the wall: a rectangle of the cell (one bay of one floor), and how deep the glass or door lies.
struct Opening {
  double u0 = 0, u1 = 0, v0 = 0, v1 = 0, depth = 0;
  bool door = false;
};

struct Cell {
  std::int64_t bay, level;
  double width, height;
  std::uint32_t hash;
};

Opening opening_of(const Part& p, const Cell& cell, std::uint32_t wall, std::int64_t bays) {
  Opening o;
  const double middle = cell.width * 0.5;
  o.depth = 0.08 + 0.2 * unit32(wall * 0x27D4EB2Fu);
  if (p.style & facade::kHall) {
    if (cell.level == 0 && cell.hash % 5 == 0) return {middle - 1.8, middle + 1.8, 0.0, 3.4, 0.15, true};
    if (cell.level == 0) return o;
    return {0.3, cell.width - 0.3, cell.height * 0.35, cell.height * 0.8, 0.1, false};
  }
  if (cell.level == 0) {
    if (cell.bay == static_cast<std::int64_t>(wall % static_cast<std::uint32_t>(bays)))
      return {middle - 0.6, middle + 0.6, 0.0, 2.25, 0.3, true};
    if (p.style & facade::kShop) return {0.22, cell.width - 0.22, 0.45, cell.height - 0.7, 0.18, false};
  }
  if (cell.hash % 16 == 0) return o;  // a blank wall now and then
  const double half = min_of((p.style & facade::kWide) ? 0.36 * cell.width : 0.23 * cell.width, 1.4);
  const double sill = (p.style & facade::kTall) ? 0.6 : 0.95;
  const double head = min_of(sill + ((p.style & facade::kTall) ? 2.0 : 1.4), cell.height - 0.35);
  return {middle - half, middle + half, sill, head, o.depth, false};
}

void accept(const LocalRay& r, Hit& hit, double t, double cosine, Material m, double albedo) {
  if (t >= hit.t) return;
  hit.t = t;
  hit.cosine = abs_of(cosine);
  hit.material = m;
  hit.albedo = albedo;
  hit.rough_m = 0;
  hit.id = r.id;
  hit.local = r.o + r.d * t;
}

// Behind the glass: blinds, a curtain, or a dark room that mostly absorbs the beam.
void look_inside(const LocalRay& r, Hit& hit, double t, double dn, const Cell& cell) {
  const double kind = unit32(cell.hash * 0x2545F491u);
  const double luck = unit32(cell_hash(r.luck, r.id, cell.bay, cell.level));
  if (kind < 0.28) return accept(r, hit, t, dn, Material::Plastic, 0.5);
  if (kind < 0.5) {
    if (luck < 0.9) return accept(r, hit, t + (0.1 + 0.04 * luck) / dn, dn, Material::Cloth, 0.22);
    return accept(r, hit, t, dn, Material::Nothing, -1);
  }
  if (luck < (kind < 0.66 ? 0.45 : 0.97)) return accept(r, hit, t, dn, Material::Nothing, -1);
  if (luck > 0.98) return accept(r, hit, t, dn, Material::Glass, -1);
  const double depth = 1.2 + 3.2 * unit32(cell.hash * 0xC2B2AE35u) - luck * 0.4;
  accept(r, hit, t + depth / dn, dn, Material::Plaster, 0.16);
}

}  // namespace

void trace_facade(const Part& p, const LocalRay& r, Hit& hit) {
  const float* a = p.a;
  const double o[3] = {r.o.x, r.o.y, r.o.z}, d[3] = {r.d.x, r.d.y, r.d.z};
  double in = 0, out = hit.t;
  int axis = -1;
  for (int k = 0; k < 3; ++k) {
    const double lo = a[2 * k], hi = a[2 * k + 1];
    if (d[k] == 0) {
      if (o[k] < lo || o[k] > hi) return;
      continue;
    }
    double t0 = (lo - o[k]) / d[k], t1 = (hi - o[k]) / d[k];
    if (t0 > t1) {
      const double swap = t0;
      t0 = t1;
      t1 = swap;
    }
    if (t0 > in) in = t0, axis = k;
    if (t1 < out) out = t1;
    if (in >= out) return;
  }
  if (axis < 0) return;
  if (axis == 2) return accept(r, hit, in, d[2], Material::Roof, -1);

  const int across = 1 - axis;  // the horizontal direction along the wall
  const double dn = abs_of(d[axis]), du = d[across], dv = d[2];
  const double width = static_cast<double>(a[2 * across + 1]) - a[2 * across];
  const double u = o[across] + in * du - a[2 * across];
  const double v = o[2] + in * dv;
  const double first = a[8], floor = a[7];
  const bool blind = (axis == 0 && (p.style & facade::kBlindEnds)) || v < 0 || v > a[5] - 0.4;
  if (!blind) {
    const std::int64_t bays = width < a[6] ? 1 : floor_of(width / a[6] + 0.5);
    const int face = 2 * axis + (d[axis] > 0 ? 0 : 1);
    const std::uint32_t wall = cell_hash(r.id, face, 3, 9);
    Cell cell;
    cell.width = width / static_cast<double>(bays);
    cell.bay = floor_of(u / cell.width);
    cell.level = v < first ? 0 : 1 + floor_of((v - first) / floor);
    cell.height = cell.level == 0 ? first : floor;
    cell.hash = cell_hash(r.id, cell.bay + 97 * face, cell.level, 5);
    const double cu = u - static_cast<double>(cell.bay) * cell.width;
    const double cv = cell.level == 0 ? v : v - first - static_cast<double>(cell.level - 1) * floor;
    const Opening open = opening_of(p, cell, wall, bays);
    if (cu > open.u0 && cu < open.u1 && cv > open.v0 && cv < open.v1) {
      const double deep = open.depth / dn;
      const double u2 = cu + du * deep, v2 = cv + dv * deep;
      if (u2 < open.u0 || u2 > open.u1 || v2 < open.v0 || v2 > open.v1) {  // the side of the recess
        const double tu = du > 0 ? (open.u1 - cu) / du : (du < 0 ? (open.u0 - cu) / du : deep);
        const double tv = dv > 0 ? (open.v1 - cv) / dv : (dv < 0 ? (open.v0 - cv) / dv : deep);
        return accept(r, hit, in + min_of(tu, tv), tu < tv ? du : dv, p.material, -1);
      }
      if (open.door) return accept(r, hit, in + deep, dn, Material::Wood, -1);
      const double edge = min_of(min_of(u2 - open.u0, open.u1 - u2), min_of(v2 - open.v0, open.v1 - v2));
      if (edge < 0.06 || abs_of(u2 - 0.5 * (open.u0 + open.u1)) < 0.035)
        return accept(r, hit, in + deep - 0.04 / dn, dn, Material::Plastic, 0.6);
      return look_inside(r, hit, in + deep, dn, cell);
    }
  }
  accept(r, hit, in, dn, p.material, -1);
}

}  // namespace lidarcodec::sim
