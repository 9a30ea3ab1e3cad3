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

// In `was`: the frame before has nothing there.
inline constexpr std::int32_t kNothing = -1;

// What planes see of each other.
struct PlaneRows {
  explicit PlaneRows(std::size_t columns)
      : value(columns),
        error(columns),
        has(columns, 1),
        equal(columns),
        leaf(columns, kCentralLeaf),
        scale(columns),
        was(columns, kNothing),
        had(columns),
        equalled(columns) {}

  Rows<std::int32_t, 3> value;  // a range plane has something likely where there is no return
  Rows<std::int32_t, 2> error;  // how far off the expectation was
  Rows<std::uint8_t, 3> has;    // of a range plane: has a return
  Rows<std::uint8_t, 2> equal;  // to the plane that it is like
  Rows<std::uint8_t, 1> leaf;   // that the number fell into

  // Of coders that follow frames before, in the cells that look in the same direction there: the mean of the numbers,
  // and of eight frames, the last one in bit 0, whether there was a return, and whether it was `equal`.
  Rows<std::uint8_t, 1> scale;  // logarithm of the width of bins
  Rows<std::int32_t, 1> was;
  Rows<std::uint8_t, 1> had, equalled;
};

// Planes that a plane looks at; null if there is none. mate: an attribute that it often is in proportion to.
struct OtherPlanes {
  const PlaneRows* range = nullptr;
  const PlaneRows* like = nullptr;
  const PlaneRows* mate = nullptr;
};

}  // namespace lidarcodec
