#include "bindings.hpp"
#include "cell_pick.hpp"
#include "error.hpp"
#include "frame_arrays.hpp"
#include "returns.hpp"

namespace {

using lidarcodec::Error;
using lidarcodec::ErrorCode;
using lidarcodec::kRows;

}  // namespace

void bind_reduction(nb::module_& m) {
  m.def(
      "returns_of",
      [](In<std::uint16_t, 2> ranges, In<std::uint16_t, 2> azimuth, In<std::uint8_t, 2> fired, In<std::int32_t, 2> rows) {
        const lidarcodec::Columns columns = columns_of(azimuth, fired);
        const lidarcodec::BeamTable table = table_of(rows);
        if (ranges.shape(0) != kRows || ranges.shape(1) != columns.width)
          throw Error(ErrorCode::Section, "ranges are (64, W), as wide as what fired");
        lidarcodec::Returns returns;
        {
          nb::gil_scoped_release release;
          returns = lidarcodec::returns_of(ranges.data(), columns, table);
        }
        const std::size_t count = returns.cell.size();
        return nb::make_tuple(give(std::move(returns.xyz), {count, 3}), give(std::move(returns.cell), {count}));
      },
      nb::arg("ranges").noconvert(), nb::arg("azimuth").noconvert(), nb::arg("fired").noconvert(),
      nb::arg("rows").noconvert(), "Points (N, 3) int32 in 1/16 mm, and cells (N,) uint32, of the returns in range-image order.");
  m.def(
      "lattice_order",
      [](In<std::uint32_t, 1> cells, In<std::uint16_t, 2> azimuth, In<std::uint8_t, 2> fired, In<std::int32_t, 2> rows) {
        const lidarcodec::Columns columns = columns_of(azimuth, fired);
        const lidarcodec::BeamTable table = table_of(rows);
        std::vector<std::uint32_t> order;
        {
          nb::gil_scoped_release release;
          order = lidarcodec::lattice_order(cells.data(), cells.shape(0), columns, table);
        }
        const std::size_t count = order.size();
        return give(std::move(order), {count});
      },
      nb::arg("cells").noconvert(), nb::arg("azimuth").noconvert(), nb::arg("fired").noconvert(),
      nb::arg("rows").noconvert(), "(N,) uint32, places in a list of returns, those on a coarse lattice of directions first.");
  m.def(
      "pick_cells",
      [](In<std::int32_t, 2> xyz, In<std::uint32_t, 1> order, std::size_t want, std::int32_t side) {
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
      "(M,) uint32, places of one point a cubic cell, `want` of them or up to a fiftieth more; and the side found, 1/16 mm.");
}
