#include <cmath>

#include "base/error.hpp"
#include "bindings.hpp"
#include "segments/clusters.hpp"
#include "segments/ground.hpp"

namespace {

using lidarcodec::Error;
using lidarcodec::ErrorCode;

constexpr std::size_t kMostPoints = std::size_t{1} << 26;

void check(const In<float, 2>& points) {
  if (points.shape(1) != 3 || points.shape(0) > kMostPoints) throw Error(ErrorCode::Section, "points are (N, 3)");
  for (std::size_t k = 0; k < points.size(); ++k)
    if (!std::isfinite(points.data()[k])) throw Error(ErrorCode::Section, "points are finite");
}

}  // namespace

void bind_segments(nb::module_& m) {
  m.def(
      "ground_points",
      [](In<float, 2> points) -> Array<std::uint8_t> {
        check(points);
        std::vector<std::uint8_t> ground;
        {
          nb::gil_scoped_release release;
          ground = lidarcodec::ground_points(points.data(), points.shape(0));
        }
        return give(std::move(ground), {points.shape(0)});
      },
      nb::arg("points").noconvert(), "Which points, float32 (N, 3) in metres, lie on the ground: uint8 (N,), 0 or 1.");
  m.def(
      "cluster_points",
      [](In<float, 2> points, In<std::uint16_t, 1> rows, In<std::uint8_t, 1> ground) -> Array<std::int32_t> {
        check(points);
        const std::size_t n = points.shape(0);
        if (rows.shape(0) != n || ground.shape(0) != n)
          throw Error(ErrorCode::Section, "a row and a ground for each point");
        for (std::size_t k = 0; k < n; ++k)
          if (rows.data()[k] >= lidarcodec::kMostRows) throw Error(ErrorCode::Section, "rows are below 4096");
        std::vector<std::int32_t> numbers;
        {
          nb::gil_scoped_release release;
          numbers = lidarcodec::cluster_points(points.data(), rows.data(), ground.data(), n);
        }
        return give(std::move(numbers), {n});
      },
      nb::arg("points").noconvert(), nb::arg("rows").noconvert(), nb::arg("ground").noconvert(),
      "Number of the object of each point, int32 (N,), -1 for ground. points: float32 (N, 3) in metres; rows: uint16 "
      "(N,), of each point's beam, from the highest down; ground: uint8 (N,).");
}
