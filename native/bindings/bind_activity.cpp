#include <nanobind/stl/pair.h>

#include "base/error.hpp"
#include "bindings.hpp"
#include "pco/groups.hpp"
#include "pco/pco.hpp"
#include "ranges/activity.hpp"

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
      "(N,) uint16, differences of `values` modulo 65536, group by group; group_of: (19,) uint8, group of each "
      "activity.");
  m.def(
      "decode_pco_groups",
      [](nb::bytes data, std::size_t returns) {
        std::vector<std::uint16_t> values;
        {
          nb::gil_scoped_release release;
          values = lidarcodec::decode_pco_groups(data_of(data), data.size(), returns);
        }
        return give(std::move(values), {returns});
      },
      nb::arg("data"), nb::arg("returns"),
      "(returns,) uint16, what a group table and its pco data hold; raises SectionError or TruncatedError unless it is "
      "that many.");
  m.def(
      "read_pco_chunk",
      [](nb::bytes data, std::size_t count) {
        std::vector<std::int16_t> numbers(count);
        std::size_t read = 0;
        {
          nb::gil_scoped_release release;
          lidarcodec::PcoReader pco(data_of(data), data.size());
          pco.read_chunk(numbers.data(), count);
          read = pco.bytes_read();
        }
        return std::pair(give(std::move(numbers), {count}), read);
      },
      nb::arg("data"), nb::arg("count"),
      "(count,) int16 of a pco header, chunk metadata and page, and how many bytes they take; raises SectionError or "
      "TruncatedError.");
}
