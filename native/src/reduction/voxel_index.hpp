// A spatial hash of points in cubic cells: nearest neighbours in a map of millions of points.
#pragma once
#include <array>
#include <cstddef>
#include <cstdint>
#include <vector>

namespace lidarcodec {

class VoxelIndex {
 public:
  // points: `count` times x y z in metres. Throws Error(Settings) for a cell that is not between 1 mm and 100 m, for
  // points further than a million cells from 0 or not finite, and for more than 2^31 points.
  VoxelIndex(const double* points, std::size_t count, double cell_m);

  std::size_t size() const { return order_.size(); }

  // Sets marks[i] = 1 for each point i within `reach_m` of any of `count` queries; leaves the others as they are.
  // A query that is not finite or out of range marks nothing. Throws Error(Settings) for a reach beyond 8 cells.
  void mark_near(const double* queries, std::size_t count, double reach_m, std::uint8_t* marks) const;

  // For each of `count` queries the point nearest to it within `reach_m`, -1 if there is none; of several at one
  // distance any, but the same at each call. Throws Error(Settings) for a reach beyond 8 cells.
  void nearest(const double* queries, std::size_t count, double reach_m, std::int32_t* found) const;

 private:
  struct Cell {
    std::uint64_t key;
    std::uint32_t begin, end;  // in order_; an empty slot has begin == end
  };
  using Place = std::array<std::int64_t, 3>;

  bool place_of(const double* point, Place& place) const;
  const Cell* find(const Place& place) const;
  void check_reach(double reach_m) const;

  double cell_m_;
  std::uint64_t slots_ = 0;  // a power of two
  std::vector<Cell> cells_;
  std::vector<std::uint32_t> order_;  // index of each point, cell by cell
  std::vector<double> points_;        // in that order
};

}  // namespace lidarcodec
