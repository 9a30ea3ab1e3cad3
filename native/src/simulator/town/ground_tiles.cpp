#include <limits>
#include <utility>

#include "simulator/town/ground.hpp"

namespace lidarcodec::sim {
namespace {

constexpr double kNowhere = 1e3;
constexpr double kCorner = 5.0;  // radius of the kerb at a street corner

// Distance to the kerb of two streets that meet, their corner rounded off.
double join(double a, double b) {
  const double u = max_of(kCorner - a, 0.0), v = max_of(kCorner - b, 0.0);
  return max_of(kCorner, min_of(a, b)) - std::sqrt(u * u + v * v);
}

Material yard(const Town& town, BlockStyle style, std::uint32_t seed, V2 p) {
  const double patch = noise_at(seed, p.x / 7.0, p.y / 7.0);
  switch (style) {
    case BlockStyle::Rows:
    case BlockStyle::OldRows:
      return patch > 0.25 ? Material::Grass : (patch > -0.2 ? Material::Slabs : Material::Gravel);
    case BlockStyle::Villas:
      return patch > 0.55 ? Material::Soil : Material::Grass;
    case BlockStyle::Flats:
      return patch > 0.6 ? Material::Gravel : Material::Grass;
    case BlockStyle::Works:
      return patch > 0.5 ? Material::Gravel : Material::Asphalt;
    case BlockStyle::Park:
      break;
  }
  const double path = noise_at(seed ^ static_cast<std::uint32_t>(town.seed()), p.x / 23.0, p.y / 23.0);
  return abs_of(path) < 0.07 ? Material::Gravel : Material::Grass;
}

}  // namespace

TownGround::Pair TownGround::pair_of(bool along_y, double at, std::int64_t other) const {
  Pair pair;
  pair.first = floor_of(at / 100.0);
  pair.low = town_.street(along_y, pair.first);
  pair.high = town_.street(along_y, pair.first + 1);
  for (int k = 0; k < 3; ++k) {
    pair.open_low[k] = town_.open(along_y, pair.first, other - 1 + k);
    pair.open_high[k] = town_.open(along_y, pair.first + 1, other - 1 + k);
  }
  return pair;
}

// What all cells of a tile share; none of them is computed yet.
void TownGround::begin(Tile& tile) const {
  tile.x0 = static_cast<double>(tile.tx) * kTile, tile.y0 = static_cast<double>(tile.ty) * kTile;
  const double cx = tile.x0 + kTile / 2, cy = tile.y0 + kTile / 2;
  tile.v = pair_of(true, cx, floor_of(cy / 100.0));
  tile.h = pair_of(false, cy, floor_of(cx / 100.0));
  tile.near_high_v = abs_of(tile.v.high.distance({cx, cy})) < abs_of(tile.v.low.distance({cx, cy}));
  tile.near_high_h = abs_of(tile.h.high.distance({cx, cy})) < abs_of(tile.h.low.distance({cx, cy}));
  tile.along_y = tile.near_high_v ? tile.v.high : tile.v.low;
  tile.along_x = tile.near_high_h ? tile.h.high : tile.h.low;
  for (int k = 0; k < 9; ++k)
    tile.styles[static_cast<std::size_t>(k)] = town_.style(tile.v.first - 1 + k / 3, tile.h.first - 1 + k % 3);
  tile.samples.assign((kCells + 1) * (kCells + 1), {std::numeric_limits<float>::quiet_NaN(), 0});
  tile.across.resize(tile.samples.size());
  tile.cover.assign(kCells * kCells, kUnknown);
}

void TownGround::make_cell(Tile& tile, int ix, int iy) const {
  for (const auto& [x, y] : {std::pair{ix + 1, iy}, std::pair{ix, iy + 1}, std::pair{ix + 1, iy + 1}})
    if (std::isnan(tile.samples[static_cast<std::size_t>(y * (kCells + 1) + x)].kerb)) make_corner(tile, x, y);
  tile.cover[static_cast<std::size_t>(iy * kCells + ix)] = make_corner(tile, ix, iy);
}

// Computes one corner of the grid. Returns the cover of the cell that begins there, a Material.
std::uint8_t TownGround::make_corner(Tile& tile, int ix, int iy) const {
  const Pair &v = tile.v, &h = tile.h;
  const V2 p{tile.x0 + ix * kStep, tile.y0 + iy * kStep};
  const double v0 = v.low.distance(p), v1 = v.high.distance(p), h0 = h.low.distance(p), h1 = h.high.distance(p);
  const int segment_v = h1 >= 0 ? 2 : (h0 >= 0 ? 1 : 0), segment_h = v1 >= 0 ? 2 : (v0 >= 0 ? 1 : 0);
  const double sv = min_of(v.open_low[segment_v] ? abs_of(v0) - v.low.half_width : kNowhere,
                           v.open_high[segment_v] ? abs_of(v1) - v.high.half_width : kNowhere);
  const double sh = min_of(h.open_low[segment_h] ? abs_of(h0) - h.low.half_width : kNowhere,
                           h.open_high[segment_h] ? abs_of(h1) - h.high.half_width : kNowhere);
  const double kerb = join(sv, sh);
  const auto seed = static_cast<std::uint32_t>(mix(town_.seed() ^ 99));
  const double lumps = 0.05 * noise_at(seed, p.x / 3.1, p.y / 3.1) + 0.1 * noise_at(seed + 1, p.x / 11.0, p.y / 11.0);
  const auto corner = static_cast<std::size_t>(iy * (kCells + 1) + ix);
  tile.samples[corner] = {static_cast<float>(kerb),
                          static_cast<float>(town_.height(p) + lumps * smooth_step(3.0, 6.0, kerb))};
  tile.across[corner] = {static_cast<float>(tile.near_high_v ? v1 : v0),
                         static_cast<float>(tile.near_high_h ? h1 : h0)};
  const double nearest = min_of(min_of(abs_of(v0), abs_of(v1)), min_of(abs_of(h0), abs_of(h1)));
  const double pavement = sv < sh ? tile.along_y.pavement : tile.along_x.pavement;
  Material cover = Material::Slabs;
  if (kerb < 0)
    cover = (sv < sh ? tile.along_y.cobbled : tile.along_x.cobbled) ? Material::Cobbles : Material::Asphalt;
  else if (nearest < 4.0)  // the bed of a closed street
    cover = nearest < 1.4 ? Material::Gravel : Material::Grass;
  else if (kerb > pavement)
    cover = yard(town_, tile.styles[static_cast<std::size_t>(segment_h * 3 + segment_v)], seed + 2, p);
  return static_cast<std::uint8_t>(cover);
}

TownGround::Tile& TownGround::tile_at(double x, double y) {
  const std::int64_t tx = floor_of(x * (1.0 / kTile)), ty = floor_of(y * (1.0 / kTile));
  std::unique_ptr<Tile>& slot = tiles_[static_cast<std::size_t>((tx & (kCache - 1)) * kCache + (ty & (kCache - 1)))];
  if (!slot) slot = std::make_unique<Tile>();
  if (slot->samples.empty() || slot->tx != tx || slot->ty != ty) {
    slot->tx = tx;
    slot->ty = ty;
    begin(*slot);
  }
  return *slot;
}

}  // namespace lidarcodec::sim
