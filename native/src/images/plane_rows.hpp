// How a plane is coded, and what planes see of each other.
#pragma once
#include <algorithm>
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

  // What a cell of another plane would be that is to the mean of its neighbours as this plane's is to its own;
  // `otherwise` where these are too small to tell.
  std::int32_t in_proportion(std::ptrdiff_t x, bool first_row, std::int32_t mean, std::int32_t most,
                             std::int32_t otherwise) const {
    const std::int32_t *here = value[0] + x, *above = value[1] + x;
    const std::int64_t around =
        first_row ? std::int64_t{8} * here[-1]
                  : std::int64_t{2} * here[-1] + 2 * above[0] + above[1] + above[-1] + here[-2] + value[2][x];
    if (around < 32) return otherwise;
    return static_cast<std::int32_t>(std::min<std::int64_t>(std::int64_t{8} * mean * here[0] / around, most));
  }

  // A run of `count` cells of an attribute, all with its usual value.
  void take_usual(std::ptrdiff_t x, std::ptrdiff_t count, std::int32_t usual) {
    std::fill_n(equal[0] + x, count, std::uint8_t{1});
    std::fill_n(leaf[0] + x, count, kCentralLeaf);
    std::fill_n(scale[0] + x, count, scale[0][x - 1]);
    std::fill_n(has[0] + x, count, std::uint8_t{1});
    std::fill_n(value[0] + x, count, usual);
    std::fill_n(error[0] + x, count, 0);
  }

  Rows<std::int32_t, 3> value;  // a range plane has something likely where there is no return
  Rows<std::int32_t, 2> error;  // how far off the expectation was
  Rows<std::uint8_t, 3> has;    // of a range plane: has a return
  Rows<std::uint8_t, 2> equal;  // to the plane that it is like
  Rows<std::uint8_t, 1> leaf;   // that the number fell into
  Rows<std::uint8_t, 1> scale;  // logarithm of the width of bins

  // Of coders that follow frames before, in the cells that look in the same direction there: the mean of the numbers,
  // and of eight frames, the last one in bit 0, whether there was a return, and whether it was `equal`.
  Rows<std::int32_t, 1> was;
  Rows<std::uint8_t, 1> had, equalled;
};

// Planes that a plane looks at; null if there is none. mate: an attribute that it often is in proportion to; kin: the
// mate, or else the first attribute of the same returns.
struct OtherPlanes {
  const PlaneRows* range = nullptr;
  const PlaneRows* like = nullptr;
  const PlaneRows* mate = nullptr;
  const PlaneRows* kin = nullptr;
};

}  // namespace lidarcodec
