#include "simulator/town/town.hpp"

namespace lidarcodec::sim {

namespace {
constexpr double kSpacing = 100.0;
}

Street Town::street(bool along_y, std::int64_t index) const {
  Rng rng(hash_of(seed_, 1 + along_y, index));
  Street s;
  s.along_y = along_y;
  s.index = index;
  s.base = static_cast<double>(index) * kSpacing + rng.between(-20.0, 20.0);
  if (rng.chance(0.7)) s.bend = rng.between(1.5, 6.0);
  s.wave = rng.between(260.0, 520.0);
  s.phase = rng.unit();
  const double kind = rng.unit();
  if (kind < 0.2) {
    s.kind = StreetClass::Lane;
    s.half_width = rng.between(3.4, 4.4), s.lane = 1.45, s.pavement = rng.between(1.3, 2.0), s.speed = 7.5;
    s.cobbled = rng.chance(0.4);
  } else if (kind < 0.6) {
    s.kind = StreetClass::Residential;
    s.half_width = rng.between(5.5, 6.6), s.lane = 1.5, s.pavement = rng.between(1.8, 3.0), s.speed = 9.5;
  } else if (kind < 0.87) {
    s.kind = StreetClass::Main;
    s.half_width = rng.between(6.2, 7.6), s.lane = 1.75, s.pavement = rng.between(2.5, 4.5), s.speed = 13.0;
  } else {
    s.kind = StreetClass::Avenue;
    s.half_width = rng.between(9.2, 10.5), s.lane = 1.75, s.pavement = rng.between(3.5, 6.0), s.speed = 14.0;
    s.two_lanes = true;
  }
  return s;
}

bool Town::open(bool along_y, std::int64_t index, std::int64_t segment) const {
  const bool closable = along_y ? ((index & 1) == 1 && (segment & 1) == 0) : ((index & 1) == 1 && (segment & 1) == 0);
  if (!closable) return true;
  const Street s = street(along_y, index);
  if (s.kind == StreetClass::Avenue || s.kind == StreetClass::Main) return true;
  return unit_of(hash_of(seed_, 31 + along_y, index, segment)) > 0.4;
}

V2 Town::crossing(std::int64_t i, std::int64_t j) const {
  const Street v = street(true, i), h = street(false, j);
  V2 p{v.base, h.base};
  for (int k = 0; k < 6; ++k) {
    p.x = v.across(p.y);
    p.y = h.across(p.x);
  }
  return p;
}

void Town::block_of(V2 p, std::int64_t& i, std::int64_t& j) const {
  i = floor_of(p.x / kSpacing + 0.5);
  while (street(true, i).distance(p) < 0) --i;
  while (street(true, i + 1).distance(p) >= 0) ++i;
  j = floor_of(p.y / kSpacing + 0.5);
  while (street(false, j).distance(p) < 0) --j;
  while (street(false, j + 1).distance(p) >= 0) ++j;
}

BlockStyle Town::style(std::int64_t i, std::int64_t j) const {
  // Quarters a few blocks wide: dense in the middle of each, gardens and works around.
  const auto noise_seed = static_cast<std::uint32_t>(mix(seed_ ^ 77));
  const double dense = noise_at(noise_seed, static_cast<double>(i) / 3.7, static_cast<double>(j) / 3.7);
  const double u = unit_of(hash_of(seed_, 41, i, j));
  if (u < 0.07) return BlockStyle::Park;
  if (dense > 0.25) return u < 0.5 ? BlockStyle::OldRows : (u < 0.9 ? BlockStyle::Rows : BlockStyle::Flats);
  if (dense > -0.2)
    return u < 0.4 ? BlockStyle::Rows
                   : (u < 0.7 ? BlockStyle::Villas : (u < 0.9 ? BlockStyle::Flats : BlockStyle::Works));
  return u < 0.65 ? BlockStyle::Villas
                  : (u < 0.82 ? BlockStyle::Flats : (u < 0.92 ? BlockStyle::Works : BlockStyle::Rows));
}

double Town::height(V2 p) const {
  const double phase = unit_of(mix(seed_ ^ 5));
  return 1.4 * sin_turns(p.x / 431.0 + 0.3 * sin_turns(p.y / 997.0) + phase) +
         0.9 * sin_turns(p.y / 367.0 + p.x / 1511.0) + 0.15 * sin_turns(p.x / 97.0 - p.y / 131.0 + phase) +
         0.02 * sin_turns(p.x / 29.0 + p.y / 23.0);
}

}  // namespace lidarcodec::sim
