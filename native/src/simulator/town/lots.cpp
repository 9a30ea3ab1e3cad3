#include "simulator/town/block_builder.hpp"

namespace lidarcodec::sim {
namespace {

// Place of a front `width` metres wide that begins at `u`: origin at its left end.
Place front(const Side& side, double u, double width, double off) {
  Place p = side.place(u + width / 2, off);
  p.at = p.local(-width / 2, 0);
  return p;
}

// The border of a garden: a hedge, a wall, pickets, a railing on a wall, wire netting, or nothing (5).
int boundary_kind(Rng& rng) {
  const double u = rng.unit();
  return u < 0.32 ? 0 : (u < 0.58 ? 1 : (u < 0.7 ? 2 : (u < 0.82 ? 3 : (u < 0.87 ? 4 : 5))));
}

// A hedge, wall or fence from x0 to x1 along a place.
void add_boundary(Rng& rng, int kind, double height, double x0, double x1, Parts& parts) {
  if (x1 - x0 < 0.4 || kind > 4) return;
  switch (kind) {
    case 0:
      parts.push_back(leaf_box(x0, x1, 0, 0.7, -0.2, height, rng.between(0.4, 0.8), 0.09));
      break;
    case 1:
      parts.push_back(box(Material::Brick, x0, x1, 0, 0.24, -0.6, height * 0.8));
      break;
    case 2:
      parts.push_back(fence(Material::Wood, x0, x1, 0.1, 0.02, height, 0.14, 0.6));
      break;
    case 3:
      parts.push_back(box(Material::Plaster, x0, x1, 0, 0.22, -0.6, 0.45));
      parts.push_back(fence(Material::Metal, x0, x1, 0.1, 0.45, height, 0.13, 0.2));
      break;
    default:
      parts.push_back(fence(Material::Metal, x0, x1, 0.1, 0.02, height + 0.4, 0.06, 0.12));
      break;
  }
}

void plant(BlockBuilder& b, Rng& rng, const Place& place, double x, double y, double size) {
  Parts parts;
  const double kind = rng.unit();
  const double h = size * rng.between(0.7, 1.3);
  const double spread = rng.between(0.2, 0.32) * h;
  if (kind < 0.45)
    add_tree(rng, parts, h, spread);
  else if (kind < 0.6)
    add_conifer(rng, parts, h, spread * 0.8);
  else
    add_bush(rng, parts, min_of(0.35 * h, 2.2), min_of(0.3 * h, 1.6));
  b.put({place.local(x, y), place.c, place.s}, parts, Label::Vegetation, rng.next());
}

// Houses along the streets that run along x leave the corners to those along y.
double corner_of(int k, double pavement, double setback, double depth) {
  return pavement + setback + ((k == 0 || k == 2) ? depth : 0.0);
}

}  // namespace

void fill_rows(BlockBuilder& b, int k, const Side& side, bool old) {
  Rng rng(hash_of(b.hash(), 21, k));
  const double setback = old || rng.chance(0.5) ? 0.0 : rng.between(2.0, 4.0);
  const int boundary = boundary_kind(rng);
  const double boundary_height = rng.between(0.7, 1.3);
  const double depth = rng.between(10.0, 13.0);
  const double off = side.street.pavement + 0.05 + setback;
  const double end = side.length() - corner_of(k, side.far_pavement, 0.0, 13.5);
  int floors = 2 + rng.below(old ? 4 : 3);
  const double begin = corner_of(k, side.near_pavement, 0.0, 13.5);
  for (double u = begin; u + 5.0 < end;) {
    HousePlan plan;
    plan.width = min_of(rng.between(old ? 11.0 : 6.5, old ? 21.0 : 15.0), end - u);
    if (end - u - plan.width < 5.0) plan.width = end - u;
    plan.depth = depth;
    if (rng.chance(0.5)) floors = 2 + rng.below(old ? 4 : 3);
    plan.floors = floors;
    plan.old = old && rng.chance(0.8);
    plan.shop = setback == 0 && rng.chance(old ? 0.5 : 0.2);
    plan.free_ends = u <= begin || u + plan.width >= end;  // at a corner the end is a front too
    const double step = setback == 0 ? rng.between(0.0, 0.25) : rng.between(0.0, 1.2);
    const Place p = front(side, u, plan.width, off + step);
    Parts parts;
    if (rng.chance(old ? 0.05 : 0.1)) {  // a gap: a gate, what stands behind it
      add_boundary(rng, 1 + rng.below(3), 1.8, 0, plan.width, parts);
      b.put(p, parts, Label::Other, rng.next());
      const double x = plan.width * rng.between(0.3, 0.7), y = rng.between(4.0, 9.0);
      plant(b, rng, p, x, y, 7.0);
    } else {
      add_row_house(rng, plan, parts);
      b.put(p, parts, Label::Building, rng.next());
      if (plan.floors > 2 && rng.chance(0.4)) {
        Parts balconies;
        add_balconies(rng, plan, balconies);
        const Place at{p.local(plan.width * (rng.chance(0.5) ? 0.3 : 0.7), 0), p.c, p.s};
        b.put(at, balconies, Label::Building, rng.next());
      }
      if (setback > 0) {
        Parts edge;
        const double gate = plan.width * rng.between(0.2, 0.7);
        add_boundary(rng, boundary, boundary_height, 0.1, gate, edge);
        add_boundary(rng, boundary, boundary_height, gate + 1.3, plan.width - 0.1, edge);
        b.put(front(side, u, plan.width, side.street.pavement + 0.1), edge,
              boundary == 0 ? Label::Vegetation : Label::Other, rng.next());
        const double x = plan.width * rng.between(0.1, 0.9);
        if (rng.chance(0.5)) plant(b, rng, p, x, -setback * 0.5, 3.0);
      }
    }
    u += plan.width;
  }
}

void fill_villas(BlockBuilder& b, int k, const Side& side) {
  Rng rng(hash_of(b.hash(), 22, k));
  const double end = side.length() - corner_of(k, side.far_pavement, 0.0, 18.0);
  const double edge = side.street.pavement + 0.15;
  const int habit = boundary_kind(rng);
  for (double u = corner_of(k, side.near_pavement, 0.0, 18.0); u + 11.0 < end;) {
    const double lot = min_of(rng.between(13.0, 22.0), end - u);
    const Place p = front(side, u, lot, edge);
    HousePlan plan;
    plan.width = min_of(rng.between(8.0, 12.5), lot - 2.0);
    plan.depth = rng.between(8.0, 10.5);
    plan.floors = 1 + rng.below(2);
    const double back = rng.between(3.0, 7.0), x = rng.between(0.5, lot - plan.width - 0.5);
    Parts house;
    add_villa(rng, plan, house);
    b.put({p.local(x, back), p.c, p.s}, house, Label::Building, rng.next());

    Parts fencing;
    const int kind = rng.chance(0.6) ? habit : boundary_kind(rng);
    const double height = rng.between(0.8, kind == 0 ? 2.1 : 1.4), drive = rng.between(0.3, lot - 4.0);
    if (kind < 5) {
      add_boundary(rng, kind, height, 0.0, drive, fencing);
      add_boundary(rng, kind, height, drive + 3.2, lot, fencing);
      b.put(p, fencing, kind == 0 ? Label::Vegetation : Label::Other, rng.next());
    }
    Parts between;  // to the neighbour, across x: its own frame turned by a quarter
    const int divider = boundary_kind(rng);
    add_boundary(rng, divider, rng.between(1.0, 1.8), 0.4, back + plan.depth + 6.0, between);
    b.put({p.local(0, 0), -p.s, p.c}, between, Label::Other, rng.next());

    if (rng.chance(0.4)) {
      const std::uint64_t id = rng.next();
      const Model& car = b.models().vehicle(usual_vehicle(id, true), id);
      b.put({p.local(drive + 1.6, 0.6 + car.length / 2), -p.s, p.c}, car, Label::Vehicle, id, usual_paint(id ^ 9));
    }
    for (int n = 0, count = 1 + rng.below(5); n < count; ++n) {
      const double px = rng.between(0.5, lot - 0.5);
      if (abs_of(px - drive - 1.6) < 2.2) continue;
      const double py = rng.chance(0.5) ? rng.between(0.8, back - 0.8) : back + plan.depth + rng.between(1.0, 6.0);
      plant(b, rng, p, px, py, 7.5);
    }
    u += lot;
  }
}

void fill_flats(BlockBuilder& b, int k, const Side& side) {
  Rng rng(hash_of(b.hash(), 23, k));
  const double end = side.length() - corner_of(k, side.far_pavement, 4.0, 16.0);
  const double off = side.street.pavement + rng.between(4.0, 8.0);
  for (double u = corner_of(k, side.near_pavement, 4.0, 16.0); u + 16.0 < end;) {
    HousePlan plan;
    plan.width = min_of(rng.between(18.0, 40.0), end - u);
    plan.depth = rng.between(9.5, 11.5);
    plan.floors = 3 + rng.below(5);
    const Place p = front(side, u, plan.width, off);
    Parts parts;
    add_flats(rng, plan, parts);
    b.put(p, parts, Label::Building, rng.next());
    for (double x = rng.between(3.0, 6.0); x < plan.width - 3.0; x += rng.between(6.0, 10.0)) {
      if (abs_of(x - plan.width * 0.25) < 3.5 || abs_of(x - plan.width * 0.75) < 3.5) continue;
      Parts balconies;
      add_balconies(rng, plan, balconies);
      b.put({p.local(x, 0), p.c, p.s}, balconies, Label::Building, rng.next());
    }
    u += plan.width + rng.between(6.0, 14.0);
  }
  const double strip = off - side.street.pavement;
  for (double u = 4.0; u < side.length() - 4.0; u += rng.between(4.0, 14.0))
    plant(b, rng, side.place(u, side.street.pavement), 0, strip * rng.between(0.2, 0.8), 6.0);
  if (rng.chance(0.6)) {
    Parts hedge;
    const double length = rng.between(8.0, 18.0);
    add_boundary(rng, 0, rng.between(0.6, 1.3), 0, length, hedge);
    b.put(front(side, min_of(10.0, side.length() * 0.2), length, side.street.pavement + 0.2), hedge, Label::Vegetation,
          rng.next());
  }
}

void fill_works(BlockBuilder& b, int k, const Side& side) {
  Rng rng(hash_of(b.hash(), 24, k));
  const double end = side.length() - corner_of(k, side.far_pavement, 3.0, 22.0);
  const double off = side.street.pavement + rng.between(5.0, 12.0);
  for (double u = corner_of(k, side.near_pavement, 3.0, 22.0); u + 14.0 < end;) {
    HousePlan plan;
    plan.width = min_of(rng.between(18.0, 36.0), end - u);
    plan.depth = rng.between(14.0, 20.0);
    Parts parts;
    add_hall(rng, plan, parts);
    b.put(front(side, u, plan.width, off), parts, Label::Building, rng.next());
    u += plan.width + rng.between(3.0, 12.0);
  }
  const int kind = rng.chance(0.6) ? 4 : 3;
  for (double u = 3.0; u < side.length() - 4.0;) {
    const double length = min_of(rng.between(10.0, 24.0), side.length() - 2.0 - u);
    Parts parts;
    add_boundary(rng, kind, 1.6, 0, length, parts);
    b.put(front(side, u, length, side.street.pavement + 0.3), parts, Label::Other, rng.next());
    u += length + (rng.chance(0.5) ? rng.between(4.0, 8.0) : 0.0);
  }
  for (double u = 8.0; u < side.length() - 8.0; u += rng.between(2.6, 7.0)) {  // cars in front of the hall
    if (rng.chance(0.5)) continue;
    const std::uint64_t id = rng.next();
    const Model& car = b.models().vehicle(usual_vehicle(id, rng.chance(0.7)), id);
    const Place p = side.place(u, side.street.pavement + 3.2);
    if (car.length < 6.5) b.put({p.at, -p.s, p.c}, car, Label::Vehicle, id, usual_paint(id ^ 9));
    u += 1.0;
  }
}

void fill_park(BlockBuilder& b, int k, const Side& side) {
  Rng rng(hash_of(b.hash(), 25, k));
  const int kind = boundary_kind(rng);
  if (kind < 5)
    for (double u = 2.0; u < side.length() - 6.0;) {
      const double length = min_of(rng.between(12.0, 25.0), side.length() - 2.0 - u);
      Parts parts;
      add_boundary(rng, kind, rng.between(0.5, 1.1), 0, length, parts);
      b.put(front(side, u, length, side.street.pavement + 0.1), parts, kind == 0 ? Label::Vegetation : Label::Other,
            rng.next());
      u += length + rng.between(1.5, 4.0);
    }
  const double deep = 0.35 * side.length();
  for (int n = 0, count = 10 + rng.below(12); n < count; ++n) {
    const double u = rng.between(4.0, side.length() - 4.0);
    const double y = 2.0 + deep * rng.unit();
    plant(b, rng, side.place(u, side.street.pavement), 0, y, 11.0);
  }
  for (int n = 0; n < 3; ++n) {
    Parts parts;
    add_bench(parts);
    const double u = rng.between(5.0, side.length() - 5.0), off = side.street.pavement + rng.between(1.0, 4.0);
    b.put(side.place(u, off), parts, Label::Other, rng.next());
  }
}

void fill_yard(BlockBuilder& b, const Side& south, const Side& east) {
  Rng rng(hash_of(b.hash(), 26));
  const double wide = south.length(), deep = east.length();
  const Place p = south.place(wide / 2, 0);
  const bool built = b.style() == BlockStyle::Rows || b.style() == BlockStyle::OldRows;
  const int trees = b.style() == BlockStyle::Works ? 2 : 5 + rng.below(8);
  for (int n = 0; n < trees; ++n) {
    const double x = wide * rng.between(-0.25, 0.25), y = deep * rng.between(0.3, 0.7);
    plant(b, rng, p, x, y, 9.0);
  }
  for (int n = 0, sheds = built ? 3 + rng.below(4) : rng.below(3); n < sheds; ++n) {
    const double w = rng.between(3.0, 9.0), h = rng.between(2.4, 4.5);
    const double x = wide * rng.between(-0.22, 0.16), y = deep * rng.between(0.3, 0.6);
    Parts parts;
    parts.push_back(box(Material::Wood, 0, w, 0, 4.0, -0.8, h));
    parts.push_back(taper(Material::Roof, -0.2, w + 0.2, -0.3, 4.3, h, -0.2, w + 0.2, 1.9, 2.1, h + 1.2));
    b.put({p.local(x, y), p.c, p.s}, parts, Label::Building, rng.next());
  }
}

}  // namespace lidarcodec::sim
