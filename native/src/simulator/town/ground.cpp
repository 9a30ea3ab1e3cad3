#include "simulator/town/ground.hpp"

namespace lidarcodec::sim {
namespace {

constexpr double kMaxGradient = 0.06;  // of the land
constexpr double kNear = 8.0;          // metres within which the land is straight to a few centimetres
constexpr double kClear = 0.2;         // height of kerbs and camber, whose gradient is larger

// Largest height of grass or pebbles above the ground.
double growth(Material m) {
  switch (m) {
    case Material::Grass:
      return 0.07;
    case Material::Gravel:
      return 0.012;
    case Material::Soil:
      return 0.03;
    case Material::Cobbles:
      return 0.012;
    default:
      return 0;
  }
}

}  // namespace

TownGround::TownGround(const Town& town) : town_(town) {}

double TownGround::surface(V2 p) {
  const Spot s = spot(p.x, p.y);
  return s.kerb < 0 ? road_z(s) : pavement_z(s);
}

void TownGround::trace(const Ray& ray, Hit& hit) {
  const V3 &o = ray.origin, &d = ray.direction;
  if (d.z > kMaxGradient) return;
  Spot s{};
  const auto above = [&](double t, double (*level)(const Spot&)) {
    s = spot(o.x + t * d.x, o.y + t * d.y);
    return o.z + t * d.z - level(s);
  };
  // Advances as far as the largest gradient allows, until the carriageway is near.
  double t0 = 0, f0 = above(t0, road_z);
  if (f0 <= 0) return;
  const double closing = 1.0 / (kMaxGradient - d.z), fall = max_of(-d.z, 0.004);
  double t = (f0 - kClear) * closing, f = f0;
  for (;;) {
    if (t >= hit.t) return;
    f = above(t, road_z);
    if (f < kNear * fall + kClear) break;
    t0 = t, f0 = f;
    t += (f - kClear) * closing;
  }
  // Secant steps to where the beam meets the level of the carriageway, then that of the pavement, 12 cm above.
  const auto meet = [&](double (*level)(const Spot&), int steps) {
    for (int k = 0; k < steps && abs_of(f) > 1e-4 * fall; ++k) {
      const double secant = (f0 - f) / (t - t0);
      const double next = t + clamp_to(f / max_of(secant, 0.003), -2.0 * kNear, 2.0 * kNear);
      t0 = t, f0 = f;
      if (next == t0) break;
      t = next;
      f = above(t, level);
    }
  };
  meet(road_z, 4);
  const double road_t = t, road_kerb = s.kerb;
  t0 = t, f0 = o.z + t * d.z - pavement_z(s);
  t = max_of(t + max_of(f0 / fall, -kNear), 0.0);
  f = above(t, pavement_z);
  if (road_kerb < 0 && s.kerb < 0) return road_t < hit.t ? shade(ray, road_t, true, hit) : void();
  meet(pavement_z, 3);
  if (s.kerb >= 0) return t < hit.t ? shade(ray, t, false, hit) : void();
  if (road_kerb < 0) return road_t < hit.t ? shade(ray, road_t, true, hit) : void();
  // Over the carriageway at the height of the pavement, under the pavement at that of the carriageway: the kerb
  // between.
  const double face = t + (road_t - t) * (-s.kerb) / (road_kerb - s.kerb);
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

Material TownGround::marking(const Tile& tile, const Across& s, V2 p) {
  const double ay = abs_of(s.y), ax = abs_of(s.x);
  const bool on_y = ay < tile.along_y.half_width, on_x = ax < tile.along_x.half_width;
  if (on_y == on_x) return Material::Asphalt;  // in the middle of a crossing
  const Street& street = on_y ? tile.along_y : tile.along_x;
  const Street& other = on_y ? tile.along_x : tile.along_y;
  if (street.kind == StreetClass::Lane || street.cobbled) return Material::Asphalt;
  const double side = on_y ? s.y : -s.x;  // positive: the lanes that go towards growing t
  const double gap = on_y ? ax - other.half_width : ay - other.half_width;
  const bool before = (on_y ? s.x : s.y) < 0;
  const double along = on_y ? p.y : p.x;
  if (gap > 1.0 && gap < 1.4 && (side > 0) == before && abs_of(side) < street.half_width - 0.3)
    return Material::RoadPaint;
  const bool busy = street.kind != StreetClass::Residential;
  if (busy && gap > 2.0 && gap < 5.0 && fraction_of(side) < 0.5) return Material::RoadPaint;
  if (gap < 6.0) return Material::Asphalt;
  if (abs_of(side) < 0.06 && (street.two_lanes || fraction_of(along / 9.0) < 0.45)) return Material::RoadPaint;
  if (street.two_lanes && abs_of(abs_of(side) - 3.4) < 0.06 && fraction_of(along / 9.0) < 0.4)
    return Material::RoadPaint;
  const double bay = street.half_width - 2.1;
  if (abs_of(abs_of(side) - bay) < 0.05 && fraction_of(along / 6.0) < 0.1) return Material::RoadPaint;
  return Material::Asphalt;
}

void TownGround::shade(const Ray& ray, double t, bool road, Hit& hit) {
  const V3 p = ray.origin + ray.direction * t;
  const Place at = place(p.x, p.y);
  const Sample* s = at.tile->samples.data() + at.corner;
  auto m = static_cast<Material>(at.tile->cover[static_cast<std::size_t>(at.cell)]);
  if (road) {
    const Across* a = at.tile->across.data() + at.corner;
    const Across here{static_cast<float>(blend(a[0].y, a[1].y, a[kCells + 1].y, a[kCells + 2].y, at)),
                      static_cast<float>(blend(a[0].x, a[1].x, a[kCells + 1].x, a[kCells + 2].x, at))};
    if (m != Material::Cobbles) m = marking(*at.tile, here, {p.x, p.y});
  } else if (s->kerb < 1.0F && (m == Material::Asphalt || m == Material::Cobbles)) {
    m = Material::Slabs;  // the kerb runs through this cell
  }
  const double gradient_x = (static_cast<double>(s[1].height) - s[0].height) * (1.0 / kStep);
  const double gradient_y = (static_cast<double>(s[kCells + 1].height) - s[0].height) * (1.0 / kStep);
  const V3& d = ray.direction;
  const double cosine =
      (gradient_x * d.x + gradient_y * d.y - d.z) / std::sqrt(1.0 + gradient_x * gradient_x + gradient_y * gradient_y);
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
