#include "sim_ground.hpp"

namespace lidarcodec::sim {
namespace {

constexpr double kSteepest = 0.07;  // no slope of the land is steeper

double blend(double a, double b, double c, double d, double fx, double fy) {
  const double low = a + (b - a) * fx, high = c + (d - c) * fx;
  return low + (high - low) * fy;
}

// Height of a stalk of grass or a pebble above the ground at most.
double growth(Material m) {
  switch (m) {
    case Material::Grass: return 0.07;
    case Material::Gravel: return 0.012;
    case Material::Soil: return 0.03;
    case Material::Cobbles: return 0.012;
    default: return 0;
  }
}

}  // namespace

TownGround::TownGround(const Town& town) : town_(town) {}

TownGround::Spot TownGround::spot(double x, double y) {
  const Tile& tile = tile_at(x, y);
  const double gx = (x - static_cast<double>(tile.tx) * kTile) * (1.0 / kStep);
  const double gy = (y - static_cast<double>(tile.ty) * kTile) * (1.0 / kStep);
  const auto ix = static_cast<int>(clamp_to(gx, 0.0, kCells - 1.0)), iy = static_cast<int>(clamp_to(gy, 0.0, kCells - 1.0));
  const Sample* s = &tile.samples[static_cast<std::size_t>(iy * (kCells + 1) + ix)];
  const double fx = gx - ix, fy = gy - iy;
  return {blend(s[0].kerb, s[1].kerb, s[kCells + 1].kerb, s[kCells + 2].kerb, fx, fy),
          blend(s[0].height, s[1].height, s[kCells + 1].height, s[kCells + 2].height, fx, fy)};
}

double TownGround::surface(V2 p) {
  const Spot s = spot(p.x, p.y);
  return s.kerb < 0 ? road_z(s) : pavement_z(s);
}

void TownGround::trace(const Ray& ray, Hit& hit) {
  const V3 &o = ray.origin, &d = ray.direction;
  if (d.z > kSteepest) return;
  const auto above = [&](double t, Spot& s) {
    s = spot(o.x + t * d.x, o.y + t * d.y);
    return o.z + t * d.z - pavement_z(s);
  };
  // Go ahead as far as the steepest land allows, at the level of the pavement, until the beam is below it.
  Spot s{};
  double t0 = 0.5, f0 = above(t0, s);
  if (f0 <= 0) return;
  const double closing = 1.0 / (kSteepest - d.z);
  double t1 = t0, f1 = f0;
  for (;;) {
    t1 = t0 + max_of(f0 * closing, 0.05 + 0.008 * t0);
    if (t1 >= hit.t + 8.0) return;
    f1 = above(t1, s);
    if (f1 <= 0) break;
    t0 = t1, f0 = f1;
  }
  double t = t1;
  for (int k = 0; k < 3; ++k) {
    t = t0 + (t1 - t0) * f0 / (f0 - f1);
    const double f = above(t, s);
    if (f > 0)
      t0 = t, f0 = f;
    else
      t1 = t, f1 = f;
  }
  if (s.kerb >= 0) return t < hit.t ? shade(ray, t, false, hit) : void();
  // Above the carriageway: the surface lies a little further down, or the far kerb stands in between.
  const double kerb0 = s.kerb, start = t;
  const double fall = 1.0 / max_of(-d.z, 0.004);
  for (int k = 0; k < 4; ++k) {
    const double f = o.z + t * d.z - road_z(s);
    t += clamp_to(f * fall, -20.0, 20.0);
    s = spot(o.x + t * d.x, o.y + t * d.y);
  }
  if (s.kerb < 0) return t < hit.t ? shade(ray, t, true, hit) : void();
  const double face = start + (t - start) * (-kerb0) / (s.kerb - kerb0);
  if (face >= hit.t) return;
  hit.t = face;
  hit.cosine = 0.5 + 0.5 * abs_of(d.x * d.y);
  hit.material = Material::Concrete;
  hit.albedo = -1;
  hit.rough_m = 0;
  hit.local = o + d * face;
  hit.label = Label::Ground;
  hit.id = 0;
}

Material TownGround::marking(const Tile& tile, const Sample& s, V2 p) const {
  const double ay = abs_of(s.across_y), ax = abs_of(s.across_x);
  const bool on_y = ay < tile.along_y.half_width, on_x = ax < tile.along_x.half_width;
  if (on_y == on_x) return Material::Asphalt;  // in the middle of a crossing
  const Street& street = on_y ? tile.along_y : tile.along_x;
  const Street& other = on_y ? tile.along_x : tile.along_y;
  if (street.kind == StreetClass::Lane || street.cobbled) return Material::Asphalt;
  const double side = on_y ? s.across_y : -s.across_x;  // positive: the lanes that go towards growing t
  const double gap = on_y ? ax - other.half_width : ay - other.half_width;
  const bool before = (on_y ? s.across_x : s.across_y) < 0;
  const double along = on_y ? p.y : p.x;
  if (gap > 1.0 && gap < 1.4 && (side > 0) == before && abs_of(side) < street.half_width - 0.3) return Material::RoadPaint;
  const bool busy = street.kind != StreetClass::Residential;
  if (busy && gap > 2.0 && gap < 5.0 && fraction_of(side) < 0.5) return Material::RoadPaint;
  if (gap < 6.0) return Material::Asphalt;
  if (abs_of(side) < 0.06 && (street.two_lanes || fraction_of(along / 9.0) < 0.45)) return Material::RoadPaint;
  if (street.two_lanes && abs_of(abs_of(side) - 3.4) < 0.06 && fraction_of(along / 9.0) < 0.4) return Material::RoadPaint;
  const double bay = street.half_width - 2.1;
  if (abs_of(abs_of(side) - bay) < 0.05 && fraction_of(along / 6.0) < 0.1) return Material::RoadPaint;
  return Material::Asphalt;
}

void TownGround::shade(const Ray& ray, double t, bool road, Hit& hit) {
  const V3 p = ray.origin + ray.direction * t;
  const Tile& tile = tile_at(p.x, p.y);
  const double gx = (p.x - static_cast<double>(tile.tx) * kTile) * (1.0 / kStep);
  const double gy = (p.y - static_cast<double>(tile.ty) * kTile) * (1.0 / kStep);
  const auto ix = static_cast<int>(clamp_to(gx, 0.0, kCells - 1.0)), iy = static_cast<int>(clamp_to(gy, 0.0, kCells - 1.0));
  const Sample* s = &tile.samples[static_cast<std::size_t>(iy * (kCells + 1) + ix)];
  const double fx = gx - ix, fy = gy - iy;
  Material m = static_cast<Material>(tile.cover[static_cast<std::size_t>(iy * kCells + ix)]);
  if (road) {
    if (m != Material::Cobbles) m = Material::Asphalt;
    Sample here = s[0];
    here.across_y = static_cast<float>(blend(s[0].across_y, s[1].across_y, s[kCells + 1].across_y, s[kCells + 2].across_y, fx, fy));
    here.across_x = static_cast<float>(blend(s[0].across_x, s[1].across_x, s[kCells + 1].across_x, s[kCells + 2].across_x, fx, fy));
    if (m == Material::Asphalt) m = marking(tile, here, {p.x, p.y});
  } else if (s->kerb < 1.0F && (m == Material::Asphalt || m == Material::Cobbles)) {
    m = Material::Slabs;  // the kerb runs through this cell
  }
  const double slope_x = (static_cast<double>(s[1].height) - s[0].height) / kStep;
  const double slope_y = (static_cast<double>(s[kCells + 1].height) - s[0].height) / kStep;
  const V3& d = ray.direction;
  const double cosine = (slope_x * d.x + slope_y * d.y - d.z) / std::sqrt(1.0 + slope_x * slope_x + slope_y * slope_y);
  const double grown = growth(m) * unit32(cell_hash(static_cast<std::uint32_t>(ray.luck), 7, 7, 7));
  hit.t = grown > 0 ? max_of(t - min_of(grown / max_of(-d.z, 0.02), 0.3 + 0.03 * t), 0.5) : t;
  hit.cosine = max_of(cosine, 0.005);
  hit.material = m;
  hit.albedo = -1;
  hit.rough_m = 0;
  hit.local = p;
  hit.label = Label::Ground;
  hit.id = 0;
}

}  // namespace lidarcodec::sim
