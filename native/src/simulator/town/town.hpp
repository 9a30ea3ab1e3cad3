// The plan of the endless town: two families of slightly curved streets about 100 m apart, closed stretches, the height
// of the land, and the use of each block. Everything is a function of the seed and the place.
#pragma once
#include <cstdint>

#include "simulator/math.hpp"

namespace lidarcodec::sim {

enum class StreetClass : std::uint8_t { Lane, Residential, Main, Avenue };
enum class BlockStyle : std::uint8_t { Rows, OldRows, Villas, Flats, Works, Park };

// One street, from end to end of the world: x as a function of y (`along_y`) or y as a function of x.
struct Street {
  bool along_y = true;
  std::int64_t index = 0;
  StreetClass kind = StreetClass::Residential;
  double base = 0, bend = 0, wave = 1, phase = 0;
  double half_width = 5;  // centre to kerb
  double lane = 1.6;      // centre to the middle of the first lane
  double pavement = 2.5;
  double speed = 10;       // of cars, m/s
  bool two_lanes = false;  // each way
  bool cobbled = false;

  // Where the street runs at `t`, its coordinate along the axis.
  double across(double t) const { return base + bend * sin_turns(t / wave + phase); }
  double derivative(double t) const { return bend * kRadiansPerTurn / wave * cos_turns(t / wave + phase); }
  V2 point(double t) const { return along_y ? V2{across(t), t} : V2{t, across(t)}; }
  // Unit vector towards growing t.
  V2 tangent(double t) const {
    const double k = derivative(t), n = 1.0 / std::sqrt(1.0 + k * k);
    return along_y ? V2{k * n, n} : V2{n, k * n};
  }
  // Distance of a point from the middle of the street, positive towards growing x (or y).
  double distance(V2 p) const {
    const double t = along_y ? p.y : p.x, k = derivative(t);
    return ((along_y ? p.x : p.y) - across(t)) / std::sqrt(1.0 + k * k);
  }
};

class Town {
 public:
  explicit Town(std::uint64_t seed) : seed_(seed) {}

  Street street(bool along_y, std::int64_t index) const;
  // Whether cars use the stretch of a street between its crossings `segment` and `segment + 1`. No crossing has fewer
  // than two open arms, one of each family.
  bool open(bool along_y, std::int64_t index, std::int64_t segment) const;
  // Middle of the crossing of street i along y and street j along x.
  V2 crossing(std::int64_t i, std::int64_t j) const;
  // Index of the block that a point lies in: between streets i and i + 1, j and j + 1.
  void block_of(V2 p, std::int64_t& i, std::int64_t& j) const;
  BlockStyle style(std::int64_t i, std::int64_t j) const;
  // Height of the land before kerbs and gutters, metres.
  double height(V2 p) const;

  std::uint64_t seed() const { return seed_; }

 private:
  std::uint64_t seed_;
};

}  // namespace lidarcodec::sim
