// The objects in a block of the town and along its streets: houses, gardens, trees, parked cars, street furniture.
#pragma once
#include <map>
#include <memory>
#include <utility>
#include <vector>

#include "simulator/town/buildings.hpp"
#include "simulator/town/ground.hpp"
#include "simulator/town/models.hpp"
#include "simulator/town/town.hpp"

namespace lidarcodec::sim {

struct Block {
  std::vector<Object> objects;
  std::vector<Part> parts;  // of the objects that have their own
  V2 center;
  double radius = 0;
  // The way round the block on its pavement, for walkers: corners in order.
  std::vector<V2> round;
  int walkers = 0;
  std::uint64_t id = 0;
};

// The blocks around the car, built when they come near and dropped when they are far.
class Blocks {
 public:
  Blocks(const Town& town, TownGround& ground, const Models& models);
  // Blocks that reach within `reach` metres of a point, in order of their indices.
  const std::vector<const Block*>& around(V2 p, double reach);

 private:
  using Key = std::pair<std::int64_t, std::int64_t>;
  const Town& town_;
  TownGround& ground_;
  const Models& models_;
  std::map<Key, std::unique_ptr<Block>> blocks_;
  std::vector<const Block*> near_;
};

// Builds one block. `i, j`: between streets i and i + 1 along y, j and j + 1 along x.
std::unique_ptr<Block> build_block(const Town& town, TownGround& ground, const Models& models, std::int64_t i,
                                   std::int64_t j);

}  // namespace lidarcodec::sim
