#include <array>

#include "simulator/town/models.hpp"

namespace lidarcodec::sim {
namespace {

using M = Material;

void add_wheels(Parts& out, double front, double rear, double half, double radius) {
  for (const double x : {front, rear}) {
    out.push_back(wheel(M::Rubber, x, radius, radius, -half, -half + 0.2));
    out.push_back(wheel(M::Rubber, x, radius, radius, half - 0.2, half));
  }
}

void add_plates(Parts& out, double nose, double tail) {
  out.push_back(box(M::Retro, nose, nose + 0.015, -0.26, 0.26, 0.42, 0.53));
  out.push_back(box(M::Retro, tail - 0.015, tail, -0.26, 0.26, 0.62, 0.73));
}

// A car body: sill, waist with sloped bonnet and boot, glazed cabin, seats behind the glass, wheels, mirrors, plates.
// `bonnet` and `boot` are the lengths in front of and behind the cabin, as shares of the length.
Model car(double length, double width, double height, double bonnet, double boot, double rake, double tail_rake) {
  Model m;
  m.length = length, m.width = width, m.height = height;
  m.kind = ObjectKind::Car;
  Parts& p = m.parts;
  const double x1 = length / 2, x0 = -x1, y = width / 2;
  const double waist = 0.5 + 0.28 * height, clear = 0.14 + 0.04 * height;
  const double cabin1 = x1 - bonnet * length, cabin0 = x0 + boot * length;
  p.push_back(taper(M::CarPaint, x0 + 0.12, x1 - 0.14, -y + 0.06, y - 0.06, clear, x0 + 0.02, x1 - 0.02, -y, y, 0.52));
  p.push_back(
      taper(M::CarPaint, x0 + 0.02, x1 - 0.02, -y, y, 0.52, x0 + 0.1, x1 - 0.22, -y + 0.05, y - 0.05, waist - 0.06));
  p.push_back(taper(M::CarPaint, cabin0 - 0.1, x1 - 0.24, -y + 0.05, y - 0.05, waist - 0.06, cabin0 + 0.05,
                    cabin1 + 0.05, -y + 0.09, y - 0.09, waist + 0.04));
  p.push_back(taper(M::Cabin, cabin0, cabin1, -y + 0.09, y - 0.09, waist, cabin0 + tail_rake, cabin1 - rake, -y + 0.26,
                    y - 0.26, height));
  p.push_back(box(M::Cloth, cabin1 - rake - 0.75, cabin1 - rake - 0.4, -y + 0.3, y - 0.3, waist - 0.1, waist + 0.32));
  p.push_back(
      box(M::Cloth, cabin0 + tail_rake + 0.25, cabin0 + tail_rake + 0.5, -y + 0.3, y - 0.3, waist - 0.1, waist + 0.25));
  p.push_back(box(M::Plastic, x1 - 0.1, x1 + 0.02, -y + 0.12, y - 0.12, 0.3, 0.44));
  p.push_back(box(M::Plastic, x0 - 0.02, x0 + 0.1, -y + 0.12, y - 0.12, 0.32, 0.48));
  p.push_back(box(M::Plastic, cabin1 - 0.35, cabin1 - 0.2, -y - 0.14, y + 0.14, waist + 0.02, waist + 0.14));
  for (const double side : {-1.0, 1.0}) {  // lamps throw light back
    const double a = side * (y - 0.36), b = side * (y - 0.08);
    p.push_back(box(M::Retro, x1 - 0.16, x1 - 0.04, min_of(a, b), max_of(a, b), 0.6, 0.7));
    p.push_back(box(M::Retro, x0 + 0.02, x0 + 0.06, min_of(a, b), max_of(a, b), 0.72, 0.84));
  }
  add_wheels(p, x1 - 0.2 * length, x0 + 0.19 * length, y - 0.01, 0.29 + 0.02 * height);
  add_plates(p, x1 + 0.02, x0 - 0.02);
  return m;
}

Model van(double length, double width, double height) {
  Model m;
  m.kind = ObjectKind::Van;
  m.length = length, m.width = width, m.height = height;
  Parts& p = m.parts;
  const double x1 = length / 2, x0 = -x1, y = width / 2;
  p.push_back(taper(M::CarPaint, x0, x1 - 0.75, -y, y, 0.3, x0 + 0.06, x1 - 1.25, -y + 0.1, y - 0.1, height));
  p.push_back(
      taper(M::CarPaint, x1 - 0.8, x1, -y + 0.02, y - 0.02, 0.28, x1 - 0.8, x1 - 0.25, -y + 0.06, y - 0.06, 1.2));
  p.push_back(taper(M::Cabin, x1 - 1.3, x1 - 0.28, -y + 0.06, y - 0.06, 1.15, x1 - 1.3, x1 - 1.0, -y + 0.16, y - 0.16,
                    height - 0.12));
  p.push_back(box(M::Cloth, x1 - 1.7, x1 - 1.35, -y + 0.2, y - 0.2, 0.9, 1.7));
  p.push_back(box(M::Plastic, x1 - 0.95, x1 - 0.82, -y - 0.2, y + 0.2, 1.25, 1.5));
  p.push_back(box(M::Plastic, x0 - 0.05, x0 + 0.05, -y + 0.1, y - 0.1, 0.35, 0.55));
  add_wheels(p, x1 - 0.19 * length, x0 + 0.2 * length, y, 0.34);
  add_plates(p, x1, x0 - 0.05);
  return m;
}

Model truck(double length, double width, double height) {
  Model m;
  m.kind = ObjectKind::Truck;
  m.length = length, m.width = width, m.height = height;
  Parts& p = m.parts;
  const double x1 = length / 2, x0 = -x1, y = width / 2;
  p.push_back(box(M::Plastic, x0, x1 - 2.1, -y, y, 1.05, height));
  p.push_back(box(M::Metal, x0 + 0.2, x1 - 0.4, -0.45, 0.45, 0.55, 0.95));
  p.push_back(
      taper(M::CarPaint, x1 - 1.9, x1, -y + 0.06, y - 0.06, 0.45, x1 - 1.9, x1 - 0.05, -y + 0.06, y - 0.06, 1.55));
  p.push_back(taper(M::Cabin, x1 - 1.9, x1 - 0.05, -y + 0.06, y - 0.06, 1.55, x1 - 1.85, x1 - 0.3, -y + 0.14, y - 0.14,
                    height - 0.5));
  p.push_back(box(M::Cloth, x1 - 1.6, x1 - 1.1, -y + 0.3, y - 0.3, 1.3, 2.1));
  p.push_back(box(M::Metal, x0 + 0.02, x0 + 0.1, -y + 0.1, y - 0.1, 0.45, 0.62));
  p.push_back(box(M::Plastic, x1 - 0.5, x1 - 0.35, -y - 0.3, y + 0.3, 1.7, 2.2));
  add_wheels(p, x1 - 1.2, x0 + 1.6, y - 0.02, 0.48);
  p.push_back(box(M::Retro, x0 - 0.02, x0, -y + 0.1, y - 0.1, 0.9, 1.0));
  add_plates(p, x1, x0);
  return m;
}

Model bus(double length, double width, double height) {
  Model m;
  m.kind = ObjectKind::Bus;
  m.length = length, m.width = width, m.height = height;
  Parts& p = m.parts;
  const double x1 = length / 2, x0 = -x1, y = width / 2;
  p.push_back(taper(M::CarPaint, x0, x1, -y + 0.03, y - 0.03, 0.3, x0, x1, -y, y, 1.4));
  p.push_back(taper(M::Cabin, x0 + 0.05, x1 - 0.02, -y + 0.02, y - 0.02, 1.4, x0 + 0.1, x1 - 0.25, -y + 0.05, y - 0.05,
                    height - 0.45));
  p.push_back(taper(M::CarPaint, x0 + 0.1, x1 - 0.25, -y + 0.05, y - 0.05, height - 0.45, x0 + 0.2, x1 - 0.4, -y + 0.2,
                    y - 0.2, height));
  for (double x = x0 + 1.2; x < x1 - 1.5; x += 1.6) {
    p.push_back(box(M::Cloth, x, x + 0.35, -y + 0.25, y - 0.25, 0.9, 1.85));
    p.push_back(box(M::Plastic, x - 0.5, x - 0.3, -y - 0.005, y + 0.005, 1.4, height - 0.4));  // pillars
  }
  p.push_back(box(M::Plastic, x1 - 0.1, x1 + 0.15, -y - 0.2, y + 0.2, 1.9, 2.3));
  add_wheels(p, x1 - 2.6, x0 + 3.1, y, 0.48);
  add_plates(p, x1, x0);
  return m;
}

// A rider's trunk, head, arms and legs over a frame: for motorbikes and bicycles under way.
void add_rider(Parts& p, double seat) {
  p.push_back(taper(M::Cloth, -0.3, 0.0, -0.2, 0.2, seat, -0.05, 0.25, -0.23, 0.23, seat + 0.6));
  p.push_back(ellipsoid(M::Skin, 0.2, 0.0, seat + 0.78, 0.12, 0.1, 0.14));
  p.push_back(cylinder(M::Cloth, 0.05, -0.15, 0.075, seat - 0.55, seat + 0.05));
  p.push_back(cylinder(M::Cloth, 0.12, 0.15, 0.075, seat - 0.45, seat + 0.05));
  p.push_back(box(M::Cloth, 0.1, 0.5, -0.3, -0.2, seat + 0.2, seat + 0.32));
  p.push_back(box(M::Cloth, 0.1, 0.5, 0.2, 0.3, seat + 0.2, seat + 0.32));
}

Model motorbike(double length) {
  Model m;
  m.length = length, m.width = 0.8, m.height = 1.55;
  m.kind = ObjectKind::Motorbike;
  Parts& p = m.parts;
  p.push_back(wheel(M::Rubber, length / 2 - 0.3, 0.3, 0.3, -0.07, 0.07));
  p.push_back(wheel(M::Rubber, -length / 2 + 0.3, 0.3, 0.3, -0.09, 0.09));
  p.push_back(taper(M::CarPaint, -0.5, 0.6, -0.18, 0.18, 0.3, -0.45, 0.4, -0.14, 0.14, 0.85));
  p.push_back(box(M::Metal, 0.35, 0.45, -0.38, 0.38, 0.95, 1.02));
  p.push_back(box(M::Retro, -length / 2 - 0.02, -length / 2, -0.1, 0.1, 0.55, 0.72));
  add_rider(p, 0.8);
  return m;
}

Model bicycle(double length) {
  Model m;
  m.length = length, m.width = 0.6, m.height = 1.75;
  m.kind = ObjectKind::Cyclist;
  Parts& p = m.parts;
  p.push_back(wheel(M::Rubber, length / 2 - 0.34, 0.34, 0.34, -0.02, 0.02));
  p.push_back(wheel(M::Rubber, -length / 2 + 0.34, 0.34, 0.34, -0.02, 0.02));
  p.push_back(box(M::Metal, -0.3, 0.4, -0.025, 0.025, 0.5, 0.6));
  p.push_back(box(M::Metal, 0.36, 0.42, -0.28, 0.28, 0.95, 1.0));
  add_rider(p, 0.95);
  return m;
}

Model make_walker(double size, double girth, double swing, bool bag) {
  Model m;
  m.length = 0.6, m.width = 0.6, m.height = 1.78 * size;
  m.kind = ObjectKind::Pedestrian;
  Parts& p = m.parts;
  const double hip = 0.85 * size, neck = 1.48 * size, step = 0.24 * swing * size;
  p.push_back(taper(M::Cloth, step - 0.08, step + 0.12, 0.03, 0.17, 0.0, -0.09, 0.09, 0.02, 0.18, hip));
  p.push_back(taper(M::Cloth, -step - 0.08, -step + 0.12, -0.17, -0.03, 0.0, -0.09, 0.09, -0.18, -0.02, hip));
  p.push_back(taper(M::Cloth, -0.12 * girth, 0.12 * girth, -0.18 * girth, 0.18 * girth, hip - 0.05, -0.11 * girth,
                    0.13 * girth, -0.23 * girth, 0.23 * girth, neck));
  p.push_back(taper(M::Cloth, -step - 0.06, -step + 0.06, 0.22 * girth, 0.22 * girth + 0.1, hip - 0.08, -0.06, 0.06,
                    0.2 * girth, 0.2 * girth + 0.1, neck - 0.04));
  p.push_back(taper(M::Cloth, step - 0.06, step + 0.06, -0.22 * girth - 0.1, -0.22 * girth, hip - 0.08, -0.06, 0.06,
                    -0.2 * girth - 0.1, -0.2 * girth, neck - 0.04));
  p.push_back(ellipsoid(M::Skin, 0.02, 0.0, 1.64 * size, 0.1, 0.085, 0.135));
  if (bag) p.push_back(box(M::Cloth, -0.3, -0.1, -0.16, 0.16, 1.0 * size, 1.45 * size));
  return m;
}

}  // namespace

Models::Models() {
  for (int kind = 0; kind <= static_cast<int>(Vehicle::Bicycle); ++kind)
    for (int size = 0; size < kSizes; ++size) {
      Rng rng(hash_of(0xCA25, kind, size));
      const std::array<double, 3> v{rng.between(-1, 1), rng.between(-1, 1), rng.between(-1, 1)};
      switch (static_cast<Vehicle>(kind)) {
        case Vehicle::Hatchback:
          vehicles_.push_back(car(3.95 + 0.25 * v[0], 1.68 + 0.07 * v[1], 1.48 + 0.05 * v[2], 0.21, 0.03, 0.75, 0.35));
          break;
        case Vehicle::Saloon:
          vehicles_.push_back(car(4.6 + 0.25 * v[0], 1.78 + 0.06 * v[1], 1.43 + 0.03 * v[2], 0.25, 0.17, 0.8, 0.6));
          break;
        case Vehicle::Estate:
          vehicles_.push_back(car(4.65 + 0.2 * v[0], 1.78 + 0.06 * v[1], 1.48 + 0.04 * v[2], 0.25, 0.02, 0.8, 0.3));
          break;
        case Vehicle::Offroad:
          vehicles_.push_back(car(4.5 + 0.25 * v[0], 1.87 + 0.06 * v[1], 1.74 + 0.08 * v[2], 0.22, 0.02, 0.6, 0.25));
          break;
        case Vehicle::Minivan:
          vehicles_.push_back(car(4.5 + 0.25 * v[0], 1.82 + 0.05 * v[1], 1.72 + 0.08 * v[2], 0.15, 0.02, 0.9, 0.15));
          break;
        case Vehicle::Van:
          vehicles_.push_back(van(5.4 + 0.6 * v[0], 1.98 + 0.05 * v[1], 2.3 + 0.3 * v[2]));
          break;
        case Vehicle::Truck:
          vehicles_.push_back(truck(8.0 + 1.2 * v[0], 2.45 + 0.05 * v[1], 3.4 + 0.25 * v[2]));
          break;
        case Vehicle::Bus:
          vehicles_.push_back(bus(11.8 + 0.3 * v[0], 2.5, 3.05 + 0.08 * v[2]));
          break;
        case Vehicle::Motorbike:
          vehicles_.push_back(motorbike(2.1 + 0.1 * v[0]));
          break;
        case Vehicle::Bicycle:
          vehicles_.push_back(bicycle(1.75 + 0.06 * v[0]));
          break;
      }
    }
  for (int build = 0; build < kBuilds; ++build) {
    Rng rng(hash_of(0xF007, build));
    const double size = build == 0 ? 0.68 : rng.between(0.9, 1.06);  // one of them is a child
    const double girth = rng.between(0.85, 1.15);
    const bool bag = rng.chance(0.4);
    for (int phase = 0; phase < kPhases; ++phase)
      walkers_.push_back(make_walker(size, girth, sin_turns(phase / static_cast<double>(kPhases)), bag));
  }
  plain_car_ = car(4.3, 1.75, 1.5, 0.21, 0.2, 0.55, 0.35);
}

const Model& Models::vehicle(Vehicle kind, std::uint64_t which) const {
  return vehicles_[static_cast<std::size_t>(kind) * kSizes + which % kSizes];
}

const Model& Models::walker(std::uint64_t which, double gait) const {
  const auto phase = static_cast<std::size_t>(fraction_of(gait) * kPhases) % kPhases;
  return walkers_[which % kBuilds * kPhases + phase];
}

Vehicle usual_vehicle(std::uint64_t h, bool parked) {
  const double u = unit_of(h);
  if (u < 0.30) return Vehicle::Hatchback;
  if (u < 0.48) return Vehicle::Saloon;
  if (u < 0.66) return Vehicle::Estate;
  if (u < 0.78) return Vehicle::Offroad;
  if (u < 0.88) return Vehicle::Minivan;
  if (u < 0.95) return Vehicle::Van;
  if (parked) return u < 0.97 ? Vehicle::Van : Vehicle::Hatchback;
  if (u < 0.965) return Vehicle::Truck;
  if (u < 0.975) return Vehicle::Bus;
  return Vehicle::Motorbike;
}

float usual_paint(std::uint64_t h) {
  const double u = unit_of(h), v = unit_of(mix(h));
  if (u < 0.24) return static_cast<float>(0.035 + 0.05 * v);  // black: many beams do not come back
  if (u < 0.5) return static_cast<float>(0.12 + 0.2 * v);
  if (u < 0.75) return static_cast<float>(0.35 + 0.2 * v);
  return static_cast<float>(0.65 + 0.2 * v);
}

}  // namespace lidarcodec::sim
