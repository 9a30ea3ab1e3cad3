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

// The two streets of a family that a tile can lie between, and which of their stretches are open.
struct Pair {
  Street low, high;
  bool open_low[3] = {}, open_high[3] = {};
  std::int64_t first = 0;
};

Pair pair_of(const Town& town, bool along_y, double at, std::int64_t other) {
  Pair pair;
  pair.first = floor_of(at / 100.0);
  pair.low = town.street(along_y, pair.first);
  pair.high = town.street(along_y, pair.first + 1);
  for (int k = 0; k < 3; ++k) {
    pair.open_low[k] = town.open(along_y, pair.first, other - 1 + k);
    pair.open_high[k] = town.open(along_y, pair.first + 1, other - 1 + k);
  }
  return pair;
}

}  // namespace

void TownGround::make(Tile& tile) const {
  const double x0 = static_cast<double>(tile.tx) * kTile, y0 = static_cast<double>(tile.ty) * kTile;
  tile.x0 = x0, tile.y0 = y0;
  const double cx = x0 + kTile / 2, cy = y0 + kTile / 2;
  const Pair v = pair_of(town_, true, cx, floor_of(cy / 100.0));
  const Pair h = pair_of(town_, false, cy, floor_of(cx / 100.0));
  const auto seed = static_cast<std::uint32_t>(mix(town_.seed() ^ 99));
  const bool near_high_v = abs_of(v.high.distance({cx, cy})) < abs_of(v.low.distance({cx, cy}));
  const bool near_high_h = abs_of(h.high.distance({cx, cy})) < abs_of(h.low.distance({cx, cy}));
  tile.along_y = near_high_v ? v.high : v.low;
  tile.along_x = near_high_h ? h.high : h.low;
  std::array<BlockStyle, 9> styles{};
  for (int k = 0; k < 9; ++k)
    styles[static_cast<std::size_t>(k)] = town_.style(v.first - 1 + k / 3, h.first - 1 + k % 3);
  tile.samples.resize((kCells + 1) * (kCells + 1));
  tile.across.resize(tile.samples.size());
  tile.cover.resize(kCells * kCells);
  for (int iy = 0; iy <= kCells; ++iy)
    for (int ix = 0; ix <= kCells; ++ix) {
      const V2 p{x0 + ix * kStep, y0 + iy * kStep};
      const double v0 = v.low.distance(p), v1 = v.high.distance(p), h0 = h.low.distance(p), h1 = h.high.distance(p);
      const int segment_v = h1 >= 0 ? 2 : (h0 >= 0 ? 1 : 0), segment_h = v1 >= 0 ? 2 : (v0 >= 0 ? 1 : 0);
      const double sv = min_of(v.open_low[segment_v] ? abs_of(v0) - v.low.half_width : kNowhere,
                               v.open_high[segment_v] ? abs_of(v1) - v.high.half_width : kNowhere);
      const double sh = min_of(h.open_low[segment_h] ? abs_of(h0) - h.low.half_width : kNowhere,
                               h.open_high[segment_h] ? abs_of(h1) - h.high.half_width : kNowhere);
      const double kerb = join(sv, sh);
      Sample& s = tile.samples[static_cast<std::size_t>(iy * (kCells + 1) + ix)];
      const double lumps =
          0.05 * noise_at(seed, p.x / 3.1, p.y / 3.1) + 0.1 * noise_at(seed + 1, p.x / 11.0, p.y / 11.0);
      s.kerb = static_cast<float>(kerb);
      s.height = static_cast<float>(town_.height(p) + lumps * smooth_step(3.0, 6.0, kerb));
      tile.across[static_cast<std::size_t>(iy * (kCells + 1) + ix)] = {static_cast<float>(near_high_v ? v1 : v0),
                                                                       static_cast<float>(near_high_h ? h1 : h0)};
      if (ix == kCells || iy == kCells) continue;
      const double nearest = min_of(min_of(abs_of(v0), abs_of(v1)), min_of(abs_of(h0), abs_of(h1)));
      const double pavement = sv < sh ? tile.along_y.pavement : tile.along_x.pavement;
      Material cover = Material::Slabs;
      if (kerb < 0)
        cover = (sv < sh ? tile.along_y.cobbled : tile.along_x.cobbled) ? Material::Cobbles : Material::Asphalt;
      else if (nearest < 4.0)  // the bed of a closed street
        cover = nearest < 1.4 ? Material::Gravel : Material::Grass;
      else if (kerb > pavement)
        cover = yard(town_, styles[static_cast<std::size_t>(segment_h * 3 + segment_v)], seed + 2, p);
      tile.cover[static_cast<std::size_t>(iy * kCells + ix)] = static_cast<std::uint8_t>(cover);
    }
}

const TownGround::Tile& TownGround::tile_at(double x, double y) {
  const std::int64_t tx = floor_of(x * (1.0 / kTile)), ty = floor_of(y * (1.0 / kTile));
  std::unique_ptr<Tile>& slot = tiles_[static_cast<std::size_t>((tx & (kCache - 1)) * kCache + (ty & (kCache - 1)))];
  if (!slot) slot = std::make_unique<Tile>();
  if (slot->samples.empty() || slot->tx != tx || slot->ty != ty) {
    slot->tx = tx;
    slot->ty = ty;
    make(*slot);
  }
  return *slot;
}

}  // namespace lidarcodec::sim
