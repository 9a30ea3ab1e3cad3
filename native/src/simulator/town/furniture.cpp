#include "simulator/town/models.hpp"

namespace lidarcodec::sim {

using M = Material;

void add_lamp(Rng& rng, Parts& p, double height) {
  const double r = rng.between(0.05, 0.09);
  p.push_back(cylinder(M::Metal, 0, 0, r * 1.6, -0.3, 1.0));
  p.push_back(cylinder(M::Metal, 0, 0, r, 1.0, height));
  const double arm = rng.between(0.3, 1.8);
  p.push_back(box(M::Metal, -0.04, 0.04, -arm, 0.0, height - 0.06, height + 0.02));
  p.push_back(box(M::Plastic, -0.13, 0.13, -arm - 0.5, -arm + 0.1, height - 0.08, height + 0.06));
}

void add_sign(Rng& rng, Parts& p) {
  p.push_back(cylinder(M::Metal, 0, 0, 0.03, -0.2, 3.0));
  const double z = rng.between(2.0, 2.3);
  const double half = rng.between(0.2, 0.32);
  // A face looks along -x or +x (traffic runs along x), now and then along y.
  if (rng.chance(0.75))
    p.push_back(box(M::Retro, -0.05, -0.035, -half, half, z, z + 2 * half));
  else
    p.push_back(box(M::Retro, -half, half, -0.05, -0.035, z, z + 1.2 * half));
  if (rng.chance(0.3)) p.push_back(box(M::Retro, -0.05, -0.035, -half, half, z - 0.45, z - 0.1));
}

void add_traffic_light(Rng& rng, Parts& p) {
  p.push_back(cylinder(M::Metal, 0, 0, 0.07, -0.2, 3.4));
  p.push_back(box(M::Plastic, -0.12, 0.12, -0.15, 0.15, 2.5, 3.4));
  if (rng.chance(0.4)) {
    const double arm = rng.between(2.5, 4.5);
    p.push_back(cylinder(M::Metal, 0, 0, 0.09, 3.0, 5.6));
    p.push_back(box(M::Metal, -0.05, 0.05, -arm, 0.0, 5.45, 5.58));
    p.push_back(box(M::Plastic, -0.15, 0.15, -arm - 0.15, -arm + 0.15, 4.9, 5.8));
  }
  if (rng.chance(0.5)) p.push_back(box(M::Plastic, -0.06, 0.06, 0.07, 0.2, 0.9, 1.2));
}

void add_shelter(Rng& rng, Parts& p) {
  const double half = rng.between(1.6, 2.6);
  p.push_back(box(M::Metal, -half - 0.1, half + 0.1, -0.3, 1.4, 2.35, 2.5));
  p.push_back(box(M::Glass, -half, half, 1.28, 1.3, 0.25, 2.2));
  p.push_back(box(M::Glass, -half, -half + 0.02, 0.1, 1.3, 0.25, 2.2));
  p.push_back(box(M::Plastic, half - 0.1, half, 0.1, 1.3, 0.1, 2.2));
  for (const double x : {-half, 0.0, half}) p.push_back(cylinder(M::Metal, x, 1.25, 0.05, 0, 2.4));
  p.push_back(box(M::Wood, -half + 0.4, half - 0.6, 0.8, 1.15, 0.42, 0.5));
}

void add_bench(Parts& p) {
  p.push_back(box(M::Wood, -0.9, 0.9, -0.2, 0.25, 0.42, 0.48));
  p.push_back(taper(M::Wood, -0.9, 0.9, 0.2, 0.26, 0.5, -0.9, 0.9, 0.32, 0.38, 0.95));
  p.push_back(box(M::Metal, -0.8, -0.72, -0.15, 0.2, 0, 0.42));
  p.push_back(box(M::Metal, 0.72, 0.8, -0.15, 0.2, 0, 0.42));
}

void add_furniture(Rng& rng, Parts& p) {
  const double size = rng.between(0.85, 1.15);
  switch (rng.below(9)) {
    case 0:
    case 1:  // wheeled bins, one to three
      for (int k = 0, n = 1 + rng.below(3); k < n; ++k) {
        const double x = 0.68 * k;
        p.push_back(
            taper(M::Plastic, x - 0.24, x + 0.24, -0.26, 0.26, 0.05, x - 0.29, x + 0.29, -0.34, 0.36, 1.02 * size));
      }
      break;
    case 2:
      p.push_back(box(M::Plastic, -0.6 * size, 0.6 * size, -0.16, 0.2, 0, 1.25 * size));
      break;  // cabinet
    case 3:
    case 4:  // bollards
      for (int k = 0, n = 1 + rng.below(4); k < n; ++k)
        p.push_back(cylinder(M::Metal, 1.5 * k, 0, 0.06 * size, -0.1, 0.95));
      break;
    case 5:  // planter
      p.push_back(taper(M::Concrete, -0.5, 0.5, -0.5, 0.5, 0, -0.6, 0.6, -0.6, 0.6, 0.5));
      p.push_back(leaves(0, 0, 0.75, 0.55, 0.55, 0.45, 0.35, 0.1));
      break;
    case 6:  // parking meter
      p.push_back(cylinder(M::Metal, 0, 0, 0.05, -0.1, 1.1));
      p.push_back(box(M::Metal, -0.12, 0.12, -0.1, 0.1, 1.1, 1.6));
      break;
    case 7:  // advertising column
      p.push_back(cylinder(M::Plaster, 0, 0, 0.6 * size, 0, 2.9));
      p.push_back(cylinder(M::Metal, 0, 0, 0.72 * size, 2.9, 3.1));
      break;
    default:
      p.push_back(cylinder(M::Plastic, 0, 0, 0.2 * size, 0, 0.95));
      break;  // litter bin
  }
}

}  // namespace lidarcodec::sim
