#include <nanobind/stl/pair.h>
#include <nanobind/stl/vector.h>

#include "base/error.hpp"
#include "bindings.hpp"
#include "frame_arrays.hpp"
#include "reduction/cell_pick.hpp"
#include "reduction/returns.hpp"
#include "reduction/seen_before.hpp"

namespace {

using lidarcodec::Error;
using lidarcodec::ErrorCode;
using lidarcodec::kRows;
using lidarcodec::Scan;

Scan scan_of(const In<float, 2>& xyz) {
  if (xyz.shape(1) != 3) throw Error(ErrorCode::Section, "points are (N, 3)");
  return {xyz.data(), xyz.shape(0)};
}

}  // namespace

void bind_reduction(nb::module_& m) {
  m.def(
      "returns_of",
      [](In<std::uint16_t, 2> ranges, In<std::uint16_t, 2> azimuth, In<std::uint8_t, 2> fired,
         In<std::int32_t, 2> rows) -> Tuple<Array<std::int32_t>, Array<std::uint32_t>> {
        const lidarcodec::Columns columns = columns_of(azimuth, fired);
        const lidarcodec::BeamTable table = table_of(rows);
        if (ranges.shape(0) != kRows || ranges.shape(1) != columns.width)
          throw Error(ErrorCode::Section, "ranges are (64, W), as wide as the columns");
        lidarcodec::Returns returns;
        {
          nb::gil_scoped_release release;
          returns = lidarcodec::returns_of(ranges.data(), columns, table);
        }
        const std::size_t count = returns.cell.size();
        return nb::make_tuple(give(std::move(returns.xyz), {count, 3}), give(std::move(returns.cell), {count}));
      },
      nb::arg("ranges").noconvert(), nb::arg("azimuth").noconvert(), nb::arg("fired").noconvert(),
      nb::arg("rows").noconvert(),
      "Points (N, 3) int32 in 1/16 mm, and cells (N,) uint32, of the returns in range-image order.");
  m.def(
      "lattice_of",
      [](In<std::uint32_t, 1> cells, In<std::uint16_t, 2> azimuth, In<std::uint8_t, 2> fired,
         In<std::int32_t, 2> rows) -> Tuple<Array<std::uint32_t>, Array<std::uint8_t>> {
        const lidarcodec::Columns columns = columns_of(azimuth, fired);
        const lidarcodec::BeamTable table = table_of(rows);
        lidarcodec::Lattice lattice;
        {
          nb::gil_scoped_release release;
          lattice = lidarcodec::lattice_of(cells.data(), cells.shape(0), columns, table);
        }
        const std::size_t count = lattice.order.size();
        return nb::make_tuple(give(std::move(lattice.order), {count}), give(std::move(lattice.level), {count}));
      },
      nb::arg("cells").noconvert(), nb::arg("azimuth").noconvert(), nb::arg("fired").noconvert(),
      nb::arg("rows").noconvert(),
      "Places (N,) uint32 in the list of returns, those on the coarsest lattice first; level (N,) uint8 of each "
      "return.");
  m.def(
      "pick_cells",
      [](In<std::int32_t, 2> xyz, In<std::uint32_t, 1> order, std::size_t want,
         std::int32_t side) -> Tuple<Array<std::uint32_t>, std::int32_t> {
        const std::size_t count = xyz.shape(0);
        if (xyz.shape(1) != 3 || order.shape(0) != count)
          throw Error(ErrorCode::Section, "points are (N, 3), and their order (N,)");
        lidarcodec::Picked picked;
        {
          nb::gil_scoped_release release;
          picked = lidarcodec::pick_cells(xyz.data(), order.data(), count, std::min(want, count), side);
        }
        const std::size_t chosen = picked.places.size();
        return nb::make_tuple(give(std::move(picked.places), {chosen}), picked.side);
      },
      nb::arg("xyz").noconvert(), nb::arg("order").noconvert(), nb::arg("want"), nb::arg("side"),
      "(M,) uint32, places of one point in each voxel, `want` of them or up to 2 % more; and the side of the voxels, "
      "1/16 mm.");
  m.def(
      "deskewed",
      [](In<std::int32_t, 2> xyz, In<std::uint32_t, 1> cells, In<float, 2> moved) {
        const std::size_t count = xyz.shape(0);
        if (xyz.shape(1) != 3 || cells.shape(0) != count || moved.shape(1) != 12)
          throw Error(ErrorCode::Section, "points are (N, 3), cells (N,), and the transforms of columns (W, 12)");
        std::vector<float> points;
        {
          nb::gil_scoped_release release;
          points = lidarcodec::deskewed(xyz.data(), cells.data(), count, moved.data(), moved.shape(0));
        }
        return give(std::move(points), {count, 3});
      },
      nb::arg("xyz").noconvert(), nb::arg("cells").noconvert(), nb::arg("moved").noconvert(),
      "(N, 3) float32, metres: points in 1/16 mm, transformed by their column. A transform is a rotation row by row, "
      "each with its "
      "component of the translation.");
  m.def(
      "ground_of",
      [](In<float, 2> xyz, In<std::uint32_t, 1> cells, In<std::uint16_t, 2> azimuth, In<std::uint8_t, 2> fired,
         In<std::int32_t, 2> rows) {
        const Scan scan = scan_of(xyz);
        if (cells.shape(0) != scan.size) throw Error(ErrorCode::Section, "points are (N, 3), and cells (N,)");
        const lidarcodec::Columns columns = columns_of(azimuth, fired);
        const lidarcodec::BeamTable table = table_of(rows);
        std::vector<std::uint8_t> ground;
        {
          nb::gil_scoped_release release;
          ground = lidarcodec::ground_of(scan, cells.data(), columns, table);
        }
        return give(std::move(ground), {scan.size});
      },
      nb::arg("xyz").noconvert(), nb::arg("cells").noconvert(), nb::arg("azimuth").noconvert(),
      nb::arg("fired").noconvert(), nb::arg("rows").noconvert(), "(N,) uint8, 1 for returns on the ground.");
  m.def(
      "unseen",
      [](In<float, 2> xyz, In<std::uint8_t, 1> ground, const std::vector<std::pair<In<float, 2>, In<float, 1>>>& past) {
        const Scan scan = scan_of(xyz);
        if (ground.shape(0) != scan.size) throw Error(ErrorCode::Section, "points are (N, 3), and ground (N,)");
        std::vector<lidarcodec::PastScan> scans;
        for (const auto& [points, placed] : past) {
          if (placed.shape(0) != 12) throw Error(ErrorCode::Section, "the transform of a scan is 12 numbers");
          lidarcodec::PastScan one{scan_of(points), {}};
          for (std::size_t i = 0; i < 12; ++i) one.placed[i] = placed.data()[i];
          scans.push_back(one);
        }
        std::vector<std::uint8_t> found;
        {
          nb::gil_scoped_release release;
          found = lidarcodec::unseen(scan, ground.data(), scans);
        }
        return give(std::move(found), {scan.size});
      },
      nb::arg("xyz").noconvert(), nb::arg("ground").noconvert(), nb::arg("past"),
      "(N,) uint8, 1 for returns without a return of a past scan near them. past: (points (N, 3), transform (12,) "
      "float32) of each.");
}
