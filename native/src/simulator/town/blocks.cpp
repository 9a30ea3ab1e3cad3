#include <algorithm>
#include <array>

#include "simulator/town/block_builder.hpp"

namespace lidarcodec::sim {

Place Side::place(double u, double off) const {
  const double t = forward ? t0 + u : t1 - u;
  const V2 tangent = street.tangent(t);
  const double k = forward ? 1.0 : -1.0;
  Place p{street.point(t), k * tangent.x, k * tangent.y};
  p.at = p.local(0, street.half_width + off);
  return p;
}

BlockBuilder::BlockBuilder(const Town& town, TownGround& ground, const Models& models, std::int64_t i, std::int64_t j)
    : town_(town),
      ground_(ground),
      models_(models),
      i_(i),
      j_(j),
      style_(town.style(i, j)),
      hash_(hash_of(town.seed(), 51, i, j)),
      block_(std::make_unique<Block>()) {}

Side BlockBuilder::side(int k) const {
  const bool along_y = k == 1 || k == 3;
  const std::int64_t index = along_y ? i_ + (k == 1) : j_ + (k == 2);
  Side s;
  s.street = town_.street(along_y, index);
  s.open = town_.open(along_y, index, along_y ? j_ : i_);
  s.forward = k < 2;
  const Street low = town_.street(!along_y, along_y ? j_ : i_), high = town_.street(!along_y, (along_y ? j_ : i_) + 1);
  const V2 a = along_y ? town_.crossing(index, j_) : town_.crossing(i_, index);
  const V2 b = along_y ? town_.crossing(index, j_ + 1) : town_.crossing(i_ + 1, index);
  s.t0 = (along_y ? a.y : a.x) + low.half_width;
  s.t1 = (along_y ? b.y : b.x) - high.half_width;
  s.near_pavement = s.forward ? low.pavement : high.pavement;
  s.far_pavement = s.forward ? high.pavement : low.pavement;
  return s;
}

void BlockBuilder::put(const Place& place, const Parts& parts, Label label, std::uint64_t id, float paint) {
  if (parts.empty()) return;
  Object o;
  o.at = {place.at.x, place.at.y, height(place.at)};
  o.c = place.c, o.s = place.s;
  o.part_count = static_cast<std::uint32_t>(parts.size());
  o.id = static_cast<std::uint32_t>(mix(id));
  o.paint = paint;
  o.label = label;
  o.parts = parts.data();
  set_bounds(o);
  o.parts = nullptr;
  own_.emplace_back(block_->objects.size(), block_->parts.size());
  block_->parts.insert(block_->parts.end(), parts.begin(), parts.end());
  block_->objects.push_back(o);
}

void BlockBuilder::put(const Place& place, const Model& model, Label label, std::uint64_t id, float paint) {
  Object o;
  o.at = {place.at.x, place.at.y, height(place.at)};
  o.c = place.c, o.s = place.s;
  o.parts = model.parts.data();
  o.part_count = static_cast<std::uint32_t>(model.parts.size());
  o.id = static_cast<std::uint32_t>(mix(id));
  o.paint = paint;
  o.label = label;
  o.kind = model.kind;
  set_bounds(o);
  block_->objects.push_back(o);
}

std::unique_ptr<Block> BlockBuilder::finish() {
  for (const auto& [object, first] : own_) block_->objects[object].parts = block_->parts.data() + first;
  return std::move(block_);
}

std::unique_ptr<Block> build_block(const Town& town, TownGround& ground, const Models& models, std::int64_t i,
                                   std::int64_t j) {
  BlockBuilder b(town, ground, models, i, j);
  std::array<Side, 4> sides;
  for (int k = 0; k < 4; ++k) sides[static_cast<std::size_t>(k)] = b.side(k);
  for (int k = 0; k < 4; ++k) {
    const Side& side = sides[static_cast<std::size_t>(k)];
    if (side.length() < 12) continue;
    fill_kerbside(b, k, side);
    switch (b.style()) {
      case BlockStyle::Rows:
        fill_rows(b, k, side, false);
        break;
      case BlockStyle::OldRows:
        fill_rows(b, k, side, true);
        break;
      case BlockStyle::Villas:
        fill_villas(b, k, side);
        break;
      case BlockStyle::Flats:
        fill_flats(b, k, side);
        break;
      case BlockStyle::Works:
        fill_works(b, k, side);
        break;
      case BlockStyle::Park:
        fill_park(b, k, side);
        break;
    }
    for (const double u : {2.0, side.length() - 2.0})
      b.block().round.push_back(side.place(u, 0.35 + 0.5 * side.street.pavement).at);
  }
  fill_yard(b, sides[0], sides[1]);
  std::unique_ptr<Block> block = b.finish();
  const V2 p = town.crossing(i, j), q = town.crossing(i + 1, j + 1);
  block->id = b.hash();
  block->center = (p + q) * 0.5;
  block->radius = 0.5 * length(q - p) + 12.0;
  Rng rng(hash_of(b.hash(), 3));
  switch (b.style()) {
    case BlockStyle::OldRows:
      block->walkers = 4 + rng.below(9);
      break;
    case BlockStyle::Rows:
      block->walkers = 2 + rng.below(6);
      break;
    case BlockStyle::Park:
      block->walkers = 2 + rng.below(6);
      break;
    case BlockStyle::Works:
      block->walkers = rng.below(3);
      break;
    default:
      block->walkers = rng.below(5);
  }
  return block;
}

Blocks::Blocks(const Town& town, TownGround& ground, const Models& models)
    : town_(town), ground_(ground), models_(models) {}

const std::vector<const Block*>& Blocks::around(V2 p, double reach) {
  std::int64_t ci = 0, cj = 0;
  town_.block_of(p, ci, cj);
  near_.clear();
  const std::int64_t n = 3;
  for (std::int64_t i = ci - n; i <= ci + n; ++i)
    for (std::int64_t j = cj - n; j <= cj + n; ++j) {
      const V2 a = town_.crossing(i, j), b = town_.crossing(i + 1, j + 1);
      if (length((a + b) * 0.5 - p) > 0.5 * length(b - a) + 12.0 + reach) continue;
      std::unique_ptr<Block>& block = blocks_[{i, j}];
      if (!block) block = build_block(town_, ground_, models_, i, j);
      near_.push_back(block.get());
    }
  if (blocks_.size() > 128)
    for (auto it = blocks_.begin(); it != blocks_.end();)
      it = length(it->second->center - p) > 3.0 * reach + 200.0 ? blocks_.erase(it) : std::next(it);
  return near_;
}

}  // namespace lidarcodec::sim
