// The ground of the town: carriageway with a crown, kerbs, pavement, yards, closed streets; and where a beam hits it.
//
// Distances to the kerb and heights are on a grid of 0.5 m, in a cache of tiles of 32 m. Memory is bounded, however far
// the car drives. A cell is computed when it is first asked for: beams and what stands in the town touch one in twenty.
#pragma once
#include <array>
#include <memory>
#include <vector>

#include "simulator/scene.hpp"
#include "simulator/town/town.hpp"

namespace lidarcodec::sim {

constexpr double kKerb = 0.12;  // height of a kerb

class TownGround {
 public:
  explicit TownGround(const Town& town);

  // Sets `hit` to the ground if it is nearer.
  void trace(const Ray& ray, Hit& hit);
  // Height of the surface, with kerbs.
  double surface(V2 p);

 private:
  static constexpr int kCells = 64;
  static constexpr double kStep = 0.5;
  static constexpr double kTile = kCells * kStep;
  static constexpr int kCache = 16;

  // The two streets of a family that a tile can lie between, and which of their stretches are open.
  struct Pair {
    Street low, high;
    bool open_low[3] = {}, open_high[3] = {};
    std::int64_t first = 0;
  };
  struct Sample {
    float kerb;    // distance to the kerb: negative on the carriageway; NaN: not computed yet
    float height;  // of the land
  };
  struct Across {
    float y, x;  // distance to the middle of the nearest street along y, along x
  };
  struct Tile {
    std::int64_t tx = 0, ty = 0;
    Pair v, h;  // along y, along x
    bool near_high_v = false, near_high_h = false;
    Street along_y, along_x;  // the nearest to its middle
    std::array<BlockStyle, 9> styles{};
    double x0 = 0, y0 = 0;
    std::vector<Sample> samples;      // (kCells + 1)^2
    std::vector<Across> across;       // likewise
    std::vector<std::uint8_t> cover;  // kCells^2, a Material, or kUnknown: the cell was not computed yet
  };
  static constexpr std::uint8_t kUnknown = 255;
  struct Spot {
    double kerb, height;
  };

  // A place in its tile: the cell, and where in it.
  struct Place {
    const Tile* tile;
    int corner, cell;
    double fx, fy;
  };

  Place place(double x, double y) {
    if (!last_ || x < last_->x0 || y < last_->y0 || x >= last_->x0 + kTile || y >= last_->y0 + kTile)
      last_ = &tile_at(x, y);
    const double gx = (x - last_->x0) * (1.0 / kStep), gy = (y - last_->y0) * (1.0 / kStep);
    int ix = static_cast<int>(gx), iy = static_cast<int>(gy);
    if (ix >= kCells) ix = kCells - 1;
    if (iy >= kCells) iy = kCells - 1;
    if (last_->cover[static_cast<std::size_t>(iy * kCells + ix)] == kUnknown) make_cell(*last_, ix, iy);
    return {last_, iy * (kCells + 1) + ix, iy * kCells + ix, gx - ix, gy - iy};
  }
  static double blend(double a, double b, double c, double d, const Place& at) {
    const double low = a + (b - a) * at.fx, high = c + (d - c) * at.fx;
    return low + (high - low) * at.fy;
  }
  Spot spot(double x, double y) {
    const Place at = place(x, y);
    const Sample* s = at.tile->samples.data() + at.corner;
    return {blend(s[0].kerb, s[1].kerb, s[kCells + 1].kerb, s[kCells + 2].kerb, at),
            blend(s[0].height, s[1].height, s[kCells + 1].height, s[kCells + 2].height, at)};
  }

  Tile& tile_at(double x, double y);
  Pair pair_of(bool along_y, double at, std::int64_t other) const;
  void begin(Tile& tile) const;
  void make_cell(Tile& tile, int ix, int iy) const;
  std::uint8_t make_corner(Tile& tile, int ix, int iy) const;
  static double pavement_z(const Spot& s) { return s.height + kKerb + 0.02 * clamp_to(s.kerb, 0.0, 3.0); }
  static double road_z(const Spot& s) { return s.height + 0.02 * clamp_to(-s.kerb, 0.0, 3.5); }
  void shade(const Ray& ray, double t, bool road, Hit& hit);
  static Material marking(const Tile& tile, const Across& across, V2 p);

  const Town& town_;
  std::array<std::unique_ptr<Tile>, static_cast<std::size_t>(kCache) * kCache> tiles_;
  Tile* last_ = nullptr;
};

}  // namespace lidarcodec::sim
