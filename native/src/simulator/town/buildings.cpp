#include "simulator/town/buildings.hpp"

namespace lidarcodec::sim {

using M = Material;

double floor_height(const HousePlan& plan) { return plan.old ? 3.5 : 2.85; }
double first_floor_height(const HousePlan& plan) { return plan.shop ? 4.0 : (plan.old ? 3.9 : 3.1); }
double eaves_height(const HousePlan& plan) {
  return first_floor_height(plan) + (plan.floors - 1) * floor_height(plan) + 0.5;
}

namespace {

constexpr double kBelow = -1.2;  // walls go on below the ground, which may be inclined

M wall_material(Rng& rng) {
  const double u = rng.unit();
  return u < 0.55 ? M::Plaster : (u < 0.85 ? M::Brick : M::Concrete);
}

std::uint16_t style_of(Rng& rng, const HousePlan& plan) {
  std::uint16_t style = rng.chance(0.35) ? facade::kWide : std::uint16_t{0};
  if (plan.shop) style |= facade::kShop;
  if (!plan.free_ends) style |= facade::kBlindEnds;
  if (plan.old) style |= facade::kTall;
  return style;
}

// A roof over x0..x1, y0..y1 from height z: ridge along x, its ends drawn in by `hip`.
void add_roof(Parts& p, double x0, double x1, double y0, double y1, double z, double rise, double hip) {
  const double ridge = 0.5 * (y0 + y1);
  p.push_back(taper(M::Roof, x0, x1, y0, y1, z, x0 + hip, x1 - hip, ridge - 0.05, ridge + 0.05, z + rise));
}

void add_chimneys(Rng& rng, const HousePlan& plan, double z, Parts& p) {
  for (int k = 0, n = 1 + rng.below(3); k < n; ++k) {
    const double x = plan.width * rng.between(0.1, 0.9);
    const double y = plan.depth * rng.between(0.35, 0.65);
    p.push_back(box(M::Brick, x - 0.35, x + 0.35, y - 0.3, y + 0.3, z, z + rng.between(2.5, 4.5)));
  }
}

}  // namespace

void add_row_house(Rng& rng, const HousePlan& plan, Parts& p) {
  const double w = plan.width, d = plan.depth, z = eaves_height(plan);
  const M wall = wall_material(rng);
  const std::uint16_t style = style_of(rng, plan);
  p.push_back(facade_box(wall, 0, w, 0, d, kBelow, z, rng.between(2.4, 3.6), floor_height(plan),
                         first_floor_height(plan), style));
  if (!plan.shop) p.push_back(box(M::Concrete, 0, w, -0.05, 0.05, kBelow, rng.between(0.35, 0.8)));  // plinth
  if (plan.shop && rng.chance(0.5)) {  // awning over the shop
    const double x = w * rng.between(0.1, 0.3);
    p.push_back(taper(M::Cloth, x, w - x, -1.6, -0.02, 2.6, x, w - x, -0.1, -0.02, 3.2));
  }
  if (plan.old) {  // cornices
    p.push_back(box(M::Plaster, 0, w, -0.14, 0, first_floor_height(plan) - 0.25, first_floor_height(plan)));
    p.push_back(box(M::Plaster, 0, w, -0.3, 0, z - 0.4, z));
  }
  if (rng.chance(0.7)) {
    const double x = rng.chance(0.5) ? 0.15 : w - 0.15;
    p.push_back(cylinder(M::Metal, x, -0.1, 0.055, 0, z));
  }
  if (rng.chance(0.3)) {  // a bay window over the first floors
    const double x = w * rng.between(0.25, 0.75);
    p.push_back(taper(wall, x - 1.5, x + 1.5, -0.9, 0.05, first_floor_height(plan), x - 1.5, x + 1.5, -0.9, 0.05,
                      z - rng.between(0.0, 3.0)));
  }
  if (rng.chance(0.25)) {  // flat roof with a set-back top floor
    p.push_back(box(M::Concrete, 0, w, -0.02, 0.25, z, z + 0.8));
    p.push_back(box(M::Plaster, 0.6, w - 0.6, 2.0, d - 0.5, z, z + 2.9));
    return;
  }
  const double rise = d * rng.between(0.3, 0.5);
  add_roof(p, -0.05, w + 0.05, -0.35, d + 0.35, z, rise, 0);
  if (rng.chance(0.5)) {  // dormers
    const int n = 1 + rng.below(3);
    for (int k = 0; k < n; ++k) {
      const double x = w * (k + 0.5) / n;
      p.push_back(taper(M::Wood, x - 0.7, x + 0.7, 0.6, 3.0, z + 0.5, x - 0.7, x + 0.7, 0.6, 3.0, z + 2.2));
    }
  }
  add_chimneys(rng, plan, z, p);
}

void add_villa(Rng& rng, const HousePlan& plan, Parts& p) {
  const double w = plan.width, d = plan.depth, z = eaves_height(plan) - (rng.chance(0.4) ? 1.0 : 0.3);
  const M wall = wall_material(rng);
  const double bay = rng.between(2.8, 4.0);
  const std::uint16_t style = style_of(rng, plan);
  p.push_back(facade_box(wall, 0, w, 0, d, kBelow, z, bay, floor_height(plan), first_floor_height(plan), style));
  p.push_back(box(M::Concrete, -0.04, w + 0.04, -0.04, d + 0.04, kBelow, 0.4));
  const double rise = d * rng.between(0.35, 0.6);
  const double hip = rng.chance(0.35) ? 0.3 * w : 0.0;
  add_roof(p, -0.45, w + 0.45, -0.5, d + 0.5, z, rise, hip);
  if (hip == 0)
    for (const double x : {0.0, w - 0.2})
      p.push_back(taper(wall, x, x + 0.2, 0, d, z, x, x + 0.2, d / 2 - 0.1, d / 2 + 0.1, z + rise * 0.9));
  if (rng.chance(0.55)) {  // a wing towards the street
    const double x = w * rng.between(0.05, 0.4), part = w * rng.between(0.35, 0.5);
    const double out = rng.between(1.2, 3.0);
    p.push_back(box(wall, x, x + part, -out, 0.2, kBelow, z - 0.4));
    p.push_back(taper(M::Roof, x - 0.3, x + part + 0.3, -out - 0.4, d / 2, z - 0.4, x + part / 2 - 0.05,
                      x + part / 2 + 0.05, -out - 0.3, d / 2, z + part * 0.42));
  }
  if (rng.chance(0.6)) {  // porch and steps
    const double x = w * rng.between(0.55, 0.85);
    p.push_back(box(M::Concrete, x - 0.9, x + 0.9, -1.4, 0, -0.3, 0.18));
    p.push_back(box(M::Concrete, x - 0.9, x + 0.9, -0.9, 0, -0.3, 0.36));
    p.push_back(box(M::Roof, x - 1.1, x + 1.1, -1.3, 0, 2.5, 2.65));
    p.push_back(cylinder(M::Wood, x - 0.95, -1.15, 0.07, 0, 2.5));
    p.push_back(cylinder(M::Wood, x + 0.95, -1.15, 0.07, 0, 2.5));
  }
  if (rng.chance(0.6)) {  // garage
    const double side = rng.chance(0.5) ? w + 0.1 : -3.4;
    const double back = rng.between(0.5, 4.0);
    p.push_back(facade_box(wall, side, side + 3.3, back, back + 6.0, kBelow, 2.9, 3.3, 2.9, 2.9, facade::kHall));
  }
  add_chimneys(rng, plan, z + 1.0, p);
}

void add_flats(Rng& rng, const HousePlan& plan, Parts& p) {
  const double w = plan.width, d = plan.depth, z = eaves_height(plan);
  const M wall = rng.chance(0.5) ? M::Concrete : M::Plaster;
  const double bay = rng.between(2.8, 4.2);
  const auto style = static_cast<std::uint16_t>(style_of(rng, plan) | facade::kWide);
  p.push_back(facade_box(wall, 0, w, 0, d, kBelow, z, bay, floor_height(plan), first_floor_height(plan), style));
  p.push_back(box(M::Concrete, -0.15, w + 0.15, -0.15, d + 0.15, z, z + 0.35));
  for (double x = w * 0.25; x < w; x += w * 0.5) {  // stairs: a porch roof and a lift house
    p.push_back(box(M::Concrete, x - 1.4, x + 1.4, -1.6, 0, 2.5, 2.7));
    p.push_back(box(M::Concrete, x - 1.3, x - 1.1, -1.5, 0, 0, 2.5));
    p.push_back(box(M::Concrete, x - 1.6, x + 1.6, d * 0.4, d * 0.75, z, z + 2.4));
  }
}

void add_hall(Rng& rng, const HousePlan& plan, Parts& p) {
  const double w = plan.width, d = plan.depth;
  const double z = rng.between(5.5, 8.5);
  const M wall = rng.chance(0.6) ? M::Metal : M::Concrete;
  p.push_back(facade_box(wall, 0, w, 0, d, kBelow, z, rng.between(4.5, 6.5), 2.0, z - 2.6, facade::kHall));
  p.push_back(box(M::Concrete, -0.06, w + 0.06, -0.06, d + 0.06, kBelow, 0.9));
  if (rng.chance(0.5))
    for (double y = 0; y + 5.0 < d; y += 5.0)  // saw-tooth roof
      p.push_back(taper(M::Roof, 0, w, y, y + 5.0, z, 0, w, y + 0.3, y + 0.4, z + 1.8));
  for (int k = 0, n = 1 + rng.below(4); k < n; ++k) {
    const double x = w * rng.between(0.1, 0.85), y = d * rng.between(0.1, 0.8);
    p.push_back(box(M::Metal, x, x + 2.2, y, y + 1.8, z, z + rng.between(0.9, 2.0)));
  }
  if (rng.chance(0.6)) {
    const double x = w * rng.between(0.2, 0.6);
    p.push_back(box(M::Concrete, x, x + 6.0, -2.5, 0, -0.5, 1.1));
    p.push_back(box(M::Metal, x - 0.3, x + 6.3, -3.0, 0, 3.6, 3.8));
  }
}

void add_balconies(Rng& rng, const HousePlan& plan, Parts& p) {
  const double half = rng.between(1.2, 2.2), out = rng.between(1.0, 1.6);
  const bool solid = rng.chance(0.45);
  for (int k = 1; k < plan.floors && k < 8; ++k) {
    const double z = first_floor_height(plan) + (k - 1) * floor_height(plan);
    p.push_back(box(M::Concrete, -half, half, -out, 0, z - 0.16, z));
    if (solid) {
      p.push_back(box(M::Plaster, -half, half, -out, -out + 0.1, z, z + 1.0));
      p.push_back(box(M::Plaster, -half, -half + 0.1, -out, 0, z, z + 1.0));
      p.push_back(box(M::Plaster, half - 0.1, half, -out, 0, z, z + 1.0));
    } else {
      p.push_back(fence(M::Metal, -half, half, -out + 0.05, z, z + 1.05, 0.12, 0.25));
    }
  }
}

}  // namespace lidarcodec::sim
