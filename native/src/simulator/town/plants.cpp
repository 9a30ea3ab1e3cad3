#include "simulator/town/models.hpp"

namespace lidarcodec::sim {

using M = Material;

void add_tree(Rng& rng, Parts& p, double height, double spread) {
  const double bare = height * rng.between(0.22, 0.38);
  const double girth = 0.025 * height * rng.between(0.6, 1.1);
  p.push_back(cylinder(M::Bark, 0, 0, girth, -0.3, bare));
  p.push_back(cylinder(M::Bark, 0, 0, girth * 0.7, bare, height * 0.75));
  const double density = rng.between(0.16, 0.42);
  const double cell = rng.between(0.13, 0.2);
  const int crowns = 2 + rng.below(4);
  const double middle = 0.5 * (bare + height);
  p.push_back(leaves(0, 0, middle, spread * 0.8, spread * 0.8, 0.5 * (height - bare), density, cell));
  for (int k = 0; k < crowns; ++k) {
    const double turn = (k + rng.unit()) / crowns;
    const double out = spread * rng.between(0.3, 0.6);
    const double r = spread * rng.between(0.4, 0.65);
    const double z = bare + (height - bare) * rng.between(0.25, 0.75);
    const double x = out * cos_turns(turn), y = out * sin_turns(turn);
    const double rz = min_of(r * rng.between(0.7, 1.0), z - 0.7 * bare);
    p.push_back(leaves(x, y, z, r, r, rz, density, cell));
    const double mid = rng.between(0.4, 0.6);  // a branch on its way there
    p.push_back(cylinder(M::Bark, x * mid, y * mid, girth * 0.35, bare * 0.9, z));
  }
}

void add_conifer(Rng& rng, Parts& p, double height, double spread) {
  p.push_back(cylinder(M::Bark, 0, 0, 0.018 * height, -0.3, height * 0.9));
  const double density = rng.between(0.3, 0.5);
  for (int k = 0; k < 4; ++k) {
    const double z = height * (0.2 + 0.2 * k);
    const double r = spread * (1.0 - 0.22 * k) * rng.between(0.9, 1.1);
    p.push_back(leaves(0, 0, z, r, r, height * 0.16, density, 0.14));
  }
}

void add_bush(Rng& rng, Parts& p, double height, double spread) {
  const int lumps = 1 + rng.below(3);
  const double density = rng.between(0.3, 0.6);
  for (int k = 0; k < lumps; ++k) {
    const double x = lumps > 1 ? rng.between(-0.6, 0.6) * spread : 0.0;
    const double y = lumps > 1 ? rng.between(-0.5, 0.5) * spread : 0.0;
    const double h = height * rng.between(0.7, 1.0);
    const double rx = spread * rng.between(0.6, 1.0);
    const double ry = spread * rng.between(0.6, 1.0);
    p.push_back(leaves(x, y, 0.45 * h, rx, ry, 0.55 * h, density, 0.1));
  }
}

}  // namespace lidarcodec::sim
