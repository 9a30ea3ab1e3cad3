#include <nanobind/stl/optional.h>

#include <array>
#include <optional>

#include "base/error.hpp"
#include "bindings.hpp"
#include "packets/points.hpp"

namespace lc = lidarcodec;

namespace {

constexpr std::size_t kFactors = 9;

void expect(bool fits, const char* what) {
  if (!fits) throw lc::Error(lc::ErrorCode::Section, what);
}

}  // namespace

void bind_points(nb::module_& m) {
  m.def(
      "points_of_returns",
      [](In<std::uint32_t, 2> range, std::optional<In<std::uint8_t, 2>> keep, In<std::uint8_t, 2> intensity,
         In<double, 2> cosine, In<double, 2> sine, In<std::int64_t, 1> t_ns, In<double, 2> factors,
         In<std::uint8_t, 1> laser_of_ring, double range_step, bool turned, bool two_point) {
        const std::size_t w = range.shape(1), rows = lc::kPointRows;
        expect(range.shape(0) == rows && intensity.shape(0) == rows && intensity.shape(1) == w &&
                   (!keep || (keep->shape(0) == rows && keep->shape(1) == w)),
               "range, keep and intensity images must all be 64 x W");
        expect(cosine.shape(0) == 2 && cosine.shape(1) == w && sine.shape(0) == 2 && sine.shape(1) == w &&
                   t_ns.shape(0) == w,
               "azimuths must be 2 x W, and times one a column");
        expect(factors.shape(0) == kFactors && factors.shape(1) == rows && laser_of_ring.shape(0) == rows,
               "factors must be 9 x 64, and lasers one a row");
        std::array<lc::PointBeam, lc::kPointRows> beams;
        for (std::size_t row = 0; row < rows; ++row) {
          const auto of = [&](std::size_t which) { return factors.data()[which * rows + row]; };
          const std::uint8_t laser = laser_of_ring.data()[row];
          beams[row] = {of(0), of(1), of(2), of(3), of(4), of(5), of(6), of(7), of(8), laser, laser >= rows / 2};
        }
        std::vector<std::uint8_t> points;
        {
          nb::gil_scoped_release release;
          points = lc::points_of_returns({w, range.data(), keep ? keep->data() : nullptr, intensity.data(),
                                          cosine.data(), sine.data(), t_ns.data()},
                                         beams.data(), range_step, turned, two_point);
        }
        const std::size_t size = points.size();
        return give(std::move(points), {size});
      },
      nb::arg("range").noconvert(), nb::arg("keep").noconvert().none(), nb::arg("intensity").noconvert(),
      nb::arg("cosine").noconvert(), nb::arg("sine").noconvert(), nb::arg("t_ns").noconvert(),
      nb::arg("factors").noconvert(), nb::arg("laser_of_ring").noconvert(), nb::arg("range_step"), nb::arg("turned"),
      nb::arg("two_point"),
      "(N * 23,) uint8, points of the returns of an HDL-64E as `lidarcodec.cloud.CLOUD_DTYPE`. factors: (9, 64), rows "
      "of distance, near_across, near_along, cos_rotation, sin_rotation, cos_vertical, sin_vertical, up, aside.");
}
