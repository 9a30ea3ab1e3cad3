// The ranges of the frame before, as a sensor that moved sees them. docs/wire-format-planes.md, "Motion", has the
// rules.
#pragma once
#include <cstdint>
#include <vector>

#include "plane_motion/directions.hpp"
#include "plane_motion/motion.hpp"

namespace lidarcodec {

// Of each cell of a frame.
struct MovedPlane {
  std::vector<std::int32_t> source;  // the cell of the frame before whose surface it sees; -1: none is known
  std::vector<std::int32_t> mean;    // its range from here, in eighths
};

class PlaneMover {
 public:
  // before, now: columns of the two frames. All are known.
  PlaneMover(const PlaneBeams& beams, const PlaneColumns& before, const PlaneColumns& now);

  // mean: (rows, columns of the frame before), ranges in eighths, below 2^23; 0: none. most: largest result.
  MovedPlane move(const std::vector<std::int32_t>& mean, const PlaneMotion& motion, std::int32_t most);

 private:
  // What fell into a cell.
  struct Cell {
    std::int64_t sum = 0;  // of weight * inverse distance
    std::int32_t weight = 0, best = 0, source = -1;
  };
  // A surface at a point of the frame before, as this frame sees it.
  struct Surface {
    std::int64_t tan, inverse, rise, along;  // of 2^24, 2^38; change of the inverse in a tangent of 1, and in a column
    Angle angle;
    std::int32_t source;
  };

  std::int64_t rise(std::size_t row, std::size_t column, std::int64_t here) const;
  std::int64_t along(std::size_t row, std::size_t column, std::int64_t here) const;
  std::int64_t inverse_at(std::size_t row, std::int64_t column) const;
  void place(const Surface& surface);
  void place_in(std::size_t row, std::int64_t weight, const Surface& surface);
  void place_at(std::size_t row, std::int64_t at, std::int64_t weight, const Surface& surface);
  void add(std::size_t cell, std::int64_t weight, std::int64_t inverse, const Surface& surface);

  std::size_t rows_;
  const PlaneBeams& beams_;
  const PlaneColumns &before_, &now_;
  std::vector<CosSin> up_, aside_, turned_;              // of rows, of rows, of columns of the frame before
  std::vector<std::int64_t> tan_;                        // of rows, in steps of 2^-24, falling
  std::vector<std::int64_t> per_gap_, per_gaps_;         // 2^40 / the gap below a row, and around it
  std::vector<std::int64_t> above_;                      // columns from a row to the same direction in the row above
  std::vector<std::uint32_t> first_row_, first_column_;  // where a search begins
  std::int64_t per_tan_ = 0;
  std::vector<std::int64_t> column_gap_, per_column_;  // to the next column, 0 if it is too far, and 2^40 / that
  std::vector<std::int32_t> inverse_;                  // of the horizontal distances of the frame before
  std::vector<Cell> cells_;
};

}  // namespace lidarcodec
