#include "ranges/activity.hpp"
#include "bindings.hpp"
#include "base/error.hpp"

namespace {

using Groups = std::array<std::uint8_t, lidarcodec::kActivities>;
using Counts = std::array<std::uint32_t, lidarcodec::kActivities>;

template <typename T>
std::array<T, lidarcodec::kActivities> table_of(const In<T, 1>& given) {
  if (given.shape(0) != lidarcodec::kActivities)
    throw lidarcodec::Error(lidarcodec::ErrorCode::Section, "a table of activities that has not 19 entries");
  std::array<T, lidarcodec::kActivities> table;
  for (std::size_t i = 0; i < table.size(); ++i) table[i] = given.data()[i];
  return table;
}

}  // namespace

void bind_activity(nb::module_& m) {
  m.def(
      "count_activities",
      [](In<std::uint16_t, 1> values) {
        Counts counts;
        {
          nb::gil_scoped_release release;
          counts = lidarcodec::count_activities(values.data(), values.shape(0));
        }
        return give(std::vector<std::uint32_t>(counts.begin(), counts.end()), {counts.size()});
      },
      nb::arg("values").noconvert(), "(19,) uint32, how many of `values`, (N,) uint16, have each activity.");
  m.def(
      "split_by_activity",
      [](In<std::uint16_t, 1> values, In<std::uint8_t, 1> group_of) {
        const Groups groups = table_of<std::uint8_t>(group_of);
        std::vector<std::uint16_t> differences;
        {
          nb::gil_scoped_release release;
          differences = lidarcodec::split_by_activity(values.data(), values.shape(0), groups);
        }
        return give(std::move(differences), {values.shape(0)});
      },
      nb::arg("values").noconvert(), nb::arg("group_of").noconvert(),
      "(N,) uint16, differences of `values` modulo 65536, group by group; group_of: (19,) uint8, group of each activity.");
  m.def(
      "join_by_activity",
      [](In<std::uint16_t, 1> differences, In<std::uint8_t, 1> group_of, In<std::uint32_t, 1> counts) {
        const Groups groups = table_of<std::uint8_t>(group_of);
        const Counts sizes = table_of<std::uint32_t>(counts);
        std::vector<std::uint16_t> values;
        {
          nb::gil_scoped_release release;
          values = lidarcodec::join_by_activity(differences.data(), differences.shape(0), groups, sizes);
        }
        return give(std::move(values), {differences.shape(0)});
      },
      nb::arg("differences").noconvert(), nb::arg("group_of").noconvert(), nb::arg("counts").noconvert(),
      "(N,) uint16, what `split_by_activity` took apart; counts: (19,) uint32, differences in each group.");
}
