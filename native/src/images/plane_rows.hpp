// How a plane is coded, and what planes see of each other.
#pragma once
#include <cstddef>
#include <cstdint>

#include "images/forms.hpp"
#include "images/numbers.hpp"
#include "images/rows.hpp"

namespace lidarcodec {

// How a plane is coded: one value, numbers near an expected one, symbols, or mostly one value.
enum class PlaneWay : std::uint8_t { Constant = 0, Numbers = 1, Symbols = 2, Sparse = 3 };

// most: the largest number of the plane.
struct PlanePlan {
  PlaneForm form;
  PlaneWay way = PlaneWay::Constant;
  std::int32_t most = 0;
  std::int32_t constant = 0;
};

// What planes see of each other.
struct PlaneRows {
  explicit PlaneRows(std::size_t columns)
      : value(columns), error(columns), has(columns, 1), equal(columns), leaf(columns, kCentralLeaf) {}

  Rows<std::int32_t, 3> value;  // a range plane has something likely where there is no return
  Rows<std::int32_t, 2> error;  // how far off the expectation was
  Rows<std::uint8_t, 3> has;    // of a range plane: has a return
  Rows<std::uint8_t, 2> equal;  // to the plane that it is like
  Rows<std::uint8_t, 1> leaf;   // that the number fell into
};

// Planes that a plane looks at; null if there is none. mate: an attribute that it often is in proportion to.
struct OtherPlanes {
  const PlaneRows* range = nullptr;
  const PlaneRows* like = nullptr;
  const PlaneRows* mate = nullptr;
};

}  // namespace lidarcodec
