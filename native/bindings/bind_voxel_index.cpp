#include "base/error.hpp"
#include "bindings.hpp"
#include "reduction/voxel_index.hpp"

namespace {

using lidarcodec::VoxelIndex;

std::size_t count_of(const In<double, 2>& points) {
  if (points.shape(1) != 3) throw lidarcodec::Error(lidarcodec::ErrorCode::Settings, "points are (N, 3)");
  return points.shape(0);
}

}  // namespace

void bind_voxel_index(nb::module_& m) {
  nb::class_<VoxelIndex>(m, "VoxelIndex", "An immutable spatial hash of points, for nearest neighbours.")
      .def(
          "__init__",
          [](VoxelIndex* self, In<double, 2> points, double cell_m) {
            const std::size_t count = count_of(points);
            nb::gil_scoped_release release;
            new (self) VoxelIndex(points.data(), count, cell_m);
          },
          nb::arg("points").noconvert(), nb::arg("cell_m"), "points: (N, 3) float64, metres.")
      .def("__len__", &VoxelIndex::size)
      .def(
          "near",
          [](const VoxelIndex& self, In<double, 2> queries, double reach_m) {
            const std::size_t count = count_of(queries);
            std::vector<std::uint8_t> marks;
            {
              nb::gil_scoped_release release;
              marks.assign(self.size(), 0);
              self.mark_near(queries.data(), count, reach_m, marks.data());
            }
            const std::size_t size = marks.size();
            return give(std::move(marks), {size});
          },
          nb::arg("queries").noconvert(), nb::arg("reach_m"),
          "(N,) uint8, 1 for each point with any of the queries (M, 3) within reach_m, at most 8 cells.")
      .def(
          "nearest",
          [](const VoxelIndex& self, In<double, 2> queries, double reach_m) {
            const std::size_t count = count_of(queries);
            std::vector<std::int32_t> found;
            {
              nb::gil_scoped_release release;
              found.resize(count);
              self.nearest(queries.data(), count, reach_m, found.data());
            }
            return give(std::move(found), {count});
          },
          nb::arg("queries").noconvert(), nb::arg("reach_m"),
          "(M,) int32, the point nearest to each of the queries (M, 3) within reach_m, at most 8 cells; -1 = none.");
}
