// Tools to set things down in a block: along one of its four sides, or anywhere.
#pragma once
#include "simulator/town/blocks.hpp"

namespace lidarcodec::sim {

// Where and which way something stands: its x axis along (c, s), its y axis to the left of that.
struct Place {
  V2 at;
  double c = 1, s = 0;
  V2 local(double x, double y) const { return {at.x + c * x - s * y, at.y + s * x + c * y}; }
};

// One side of a block, walked counter-clockwise: x runs along the street, y into the block.
struct Side {
  Street street;
  bool open = true;
  bool forward = true;                         // x runs towards growing t
  double t0 = 0, t1 = 0;                       // between the kerbs of the crossing streets
  double near_pavement = 2, far_pavement = 2;  // of the crossing streets, at x = 0 and at the end
  double length() const { return t1 - t0; }
  // `u` metres along, `off` metres from the kerb into the block.
  Place place(double u, double off) const;
};

class BlockBuilder {
 public:
  BlockBuilder(const Town& town, TownGround& ground, const Models& models, std::int64_t i, std::int64_t j);

  Side side(int k) const;  // 0 south, 1 east, 2 north, 3 west
  double height(V2 p) { return ground_.surface(p); }
  // Sets down an object of its own parts, or of a shared model.
  void put(const Place& place, const Parts& parts, Label label, std::uint64_t id, float paint = 0.4F);
  void put(const Place& place, const Model& model, Label label, std::uint64_t id, float paint);
  std::unique_ptr<Block> finish();

  const Models& models() const { return models_; }
  Block& block() { return *block_; }
  BlockStyle style() const { return style_; }
  std::uint64_t hash() const { return hash_; }

 private:
  const Town& town_;
  TownGround& ground_;
  const Models& models_;
  std::int64_t i_, j_;
  BlockStyle style_;
  std::uint64_t hash_;
  std::unique_ptr<Block> block_;
  std::vector<std::pair<std::size_t, std::size_t>> own_;  // object, first part
};

// The strip along a street: parked cars, trees, lamps, signs, furniture.
void fill_kerbside(BlockBuilder& b, int k, const Side& side);
// Houses, gardens, yards.
void fill_rows(BlockBuilder& b, int k, const Side& side, bool old);
void fill_villas(BlockBuilder& b, int k, const Side& side);
void fill_flats(BlockBuilder& b, int k, const Side& side);
void fill_works(BlockBuilder& b, int k, const Side& side);
void fill_park(BlockBuilder& b, int k, const Side& side);
void fill_yard(BlockBuilder& b, const Side& south, const Side& east);

}  // namespace lidarcodec::sim
