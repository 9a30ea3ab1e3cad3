#include "simulator/town/block_builder.hpp"

namespace lidarcodec::sim {
namespace {

constexpr double kCornerFree = 9.0;  // nothing is parked or planted nearer to a corner

void park_cars(BlockBuilder& b, const Side& side, Rng& rng) {
  if (!side.open || side.street.kind == StreetClass::Lane) return;
  const double taken = rng.between(0.15, 0.92);  // some streets are full
  for (double u = kCornerFree; u < side.length() - kCornerFree;) {
    const std::uint64_t id = rng.next();
    const Model& model = b.models().vehicle(usual_vehicle(id, true), mix(id ^ 3));
    const double gap = rng.between(0.5, 1.4);
    if (u + model.length > side.length() - kCornerFree) break;
    if (rng.chance(taken)) {
      Place p = side.place(u + model.length / 2, -0.18 - model.width / 2 + 0.1 * rng.normal());
      const double turn = 0.012 * rng.normal();
      const double c = -(p.c - turn * p.s), s = -(p.s + turn * p.c);  // its right side to the kerb
      p.c = c, p.s = s;
      b.put(p, model, Label::Vehicle, id, usual_paint(id ^ 9));
    }
    u += model.length + gap;
  }
}

void plant_row(BlockBuilder& b, const Side& side, Rng& rng) {
  const double space = rng.between(8.0, 15.0);
  const double height = rng.between(5.5, 12.0);
  const double spread = rng.between(1.5, 3.2);
  const double off = side.open ? 0.75 : rng.between(-3.0, 0.5);
  for (double u = kCornerFree + rng.between(0.0, 5.0); u < side.length() - kCornerFree; u += space) {
    if (rng.chance(0.2)) continue;
    Parts parts;
    const double h = height * rng.between(0.75, 1.2);
    add_tree(rng, parts, h, spread * rng.between(0.75, 1.2));
    b.put(side.place(u, off), parts, Label::Vegetation, rng.next());
  }
}

}  // namespace

void fill_kerbside(BlockBuilder& b, int k, const Side& side) {
  Rng rng(hash_of(b.hash(), 11, k));
  park_cars(b, side, rng);
  const double green = b.style() == BlockStyle::OldRows ? 0.35 : 0.5;
  const bool room = side.street.pavement > 1.7;
  if ((room && rng.chance(green)) || !side.open) plant_row(b, side, rng);
  if (!side.open && rng.chance(0.7)) plant_row(b, side, rng);

  const double lamp = rng.between(5.0, 8.5);
  if (rng.chance(0.75))
    for (double u = rng.between(6.0, 20.0); u < side.length() - 4.0; u += rng.between(24.0, 34.0)) {
      Parts parts;
      add_lamp(rng, parts, lamp);
      b.put(side.place(u, 0.45), parts, Label::Pole, rng.next());
    }
  for (double u = rng.between(4.0, 16.0); u < side.length() - 3.0; u += rng.between(9.0, 30.0)) {
    Parts parts;
    Place p = side.place(u, 0.4);
    if (rng.chance(0.45)) {
      add_sign(rng, parts);
      b.put(p, parts, Label::Pole, rng.next());
    } else {
      add_furniture(rng, parts);
      const double back = rng.chance(0.5) ? side.street.pavement - 0.45 : 0.5;
      b.put(side.place(u, back), parts, Label::Other, rng.next());
    }
  }
  const bool busy = side.street.kind == StreetClass::Main || side.street.kind == StreetClass::Avenue;
  if (side.open && busy) {
    for (const double u : {0.6, side.length() - 0.6}) {
      Parts parts;
      add_traffic_light(rng, parts);
      b.put(side.place(u, 1.2), parts, Label::Pole, rng.next());
    }
    if (rng.chance(0.4) && side.street.pavement > 2.4) {
      Parts parts;
      add_shelter(rng, parts);
      const double u = side.length() * rng.between(0.3, 0.7);
      b.put(side.place(u, 0.9), parts, Label::Other, rng.next());
    }
  }
  if (side.open && rng.chance(0.35)) {  // bicycles at a rack
    const double u = rng.between(8.0, max_of(9.0, side.length() - 8.0));
    for (int n = 0, count = 2 + rng.below(5); n < count; ++n) {
      const Model& bike = b.models().vehicle(Vehicle::Bicycle, 0);
      Place p = side.place(u + 0.6 * n, side.street.pavement - 0.9);
      const double c = -p.s, s = p.c;
      p.c = c, p.s = s;
      b.put(p, Parts(bike.parts.begin(), bike.parts.begin() + 4), Label::Other, rng.next());
    }
  }
}

}  // namespace lidarcodec::sim
