#include <algorithm>

#include "base/error.hpp"
#include "bindings.hpp"
#include "planes/neighbour.hpp"

namespace {

template <typename T>
std::array<T, 256> table_of(const In<T, 1>& given) {
  if (given.shape(0) != 256)
    throw lidarcodec::Error(lidarcodec::ErrorCode::Section, "a table of neighbours that has not 256 entries");
  std::array<T, 256> table;
  std::copy_n(given.data(), table.size(), table.begin());
  return table;
}

}  // namespace

void bind_neighbour(nb::module_& m) {
  m.def(
      "split_by_neighbour",
      [](In<std::uint8_t, 1> bytes, In<std::uint8_t, 1> group_of) {
        const auto groups = table_of<std::uint8_t>(group_of);
        std::vector<std::uint8_t> sorted;
        {
          nb::gil_scoped_release release;
          sorted = lidarcodec::split_by_neighbour(bytes.data(), bytes.shape(0), groups);
        }
        return give(std::move(sorted), {bytes.shape(0)});
      },
      nb::arg("bytes").noconvert(), nb::arg("group_of").noconvert(),
      "(N,) uint8, `bytes` group by group; group_of: (256,) uint8, group of a byte by the one before it.");
  m.def(
      "join_by_neighbour",
      [](In<std::uint8_t, 1> sorted, In<std::uint8_t, 1> group_of, In<std::uint32_t, 1> counts) {
        const auto groups = table_of<std::uint8_t>(group_of);
        const auto sizes = table_of<std::uint32_t>(counts);
        std::vector<std::uint8_t> bytes;
        {
          nb::gil_scoped_release release;
          bytes = lidarcodec::join_by_neighbour(sorted.data(), sorted.shape(0), groups, sizes);
        }
        return give(std::move(bytes), {sorted.shape(0)});
      },
      nb::arg("sorted").noconvert(), nb::arg("group_of").noconvert(), nb::arg("counts").noconvert(),
      "(N,) uint8, what `split_by_neighbour` sorted; counts: (256,) uint32, bytes in each group.");
}
