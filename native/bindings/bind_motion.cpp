#include "base/error.hpp"
#include "bindings.hpp"
#include "frame_arrays.hpp"
#include "motion/beams.hpp"
#include "motion/range_history.hpp"
#include "motion/registration.hpp"
#include "motion/warp.hpp"

namespace {

using lidarcodec::BeamTable;
using lidarcodec::Columns;
using lidarcodec::Error;
using lidarcodec::ErrorCode;
using lidarcodec::kRows;
using lidarcodec::Motion;
using lidarcodec::RangeHistory;

Motion motion_of(const In<std::int32_t, 1>& numbers) {
  if (numbers.shape(0) != 12) throw Error(ErrorCode::Section, "a motion is 12 numbers");
  Motion motion;
  for (std::size_t i = 0; i < 9; ++i) motion.rotation[i] = numbers.data()[i];
  for (std::size_t i = 0; i < 3; ++i) motion.translation[i] = numbers.data()[9 + i];
  return motion;
}

}  // namespace

void bind_motion(nb::module_& m) {
  nb::class_<RangeHistory>(m, "RangeHistory", "The ranges last seen in each direction; see lidarcodec.motion.warp.")
      .def(nb::init<>())
      .def(
          "copy", [](const RangeHistory& self) { return RangeHistory(self); }, "Another one that has seen the same.")
      .def("forget", &RangeHistory::forget, "Forgets everything.")
      .def(
          "remember",
          [](RangeHistory& self, In<std::uint16_t, 2> ranges, In<std::uint16_t, 2> azimuth, In<std::uint8_t, 2> fired,
             In<std::int32_t, 2> rows) {
            const Columns columns = columns_of(azimuth, fired);
            const BeamTable table = table_of(rows);
            if (ranges.shape(0) != kRows || ranges.shape(1) != columns.width)
              throw Error(ErrorCode::Section, "ranges are (64, W), as wide as the columns");
            nb::gil_scoped_release release;
            self.remember(ranges.data(), columns, table.half);
          },
          nb::arg("ranges").noconvert(), nb::arg("azimuth").noconvert(), nb::arg("fired").noconvert(),
          nb::arg("rows").noconvert(), "Stores the ranges (64, W) of a frame that was sent.")
      .def(
          "expected",
          [](const RangeHistory& self, In<std::int32_t, 1> motion, In<std::uint16_t, 2> azimuth,
             In<std::uint8_t, 2> fired, In<std::int32_t, 2> rows) {
            const Columns columns = columns_of(azimuth, fired);
            const BeamTable table = table_of(rows);
            const Motion moved = motion_of(motion);
            std::vector<std::uint16_t> ranges;
            {
              nb::gil_scoped_release release;
              ranges = lidarcodec::expected_ranges(self, table, moved, columns);
            }
            return give(std::move(ranges), {kRows, columns.width});
          },
          nb::arg("motion").noconvert(), nb::arg("azimuth").noconvert(), nb::arg("fired").noconvert(),
          nb::arg("rows").noconvert(), "(64, W) uint16, the expected ranges of a frame; 0: unknown.")
      .def(
          "find_motion",
          [](const RangeHistory& self, In<std::uint16_t, 2> ranges, In<std::uint16_t, 2> azimuth,
             In<std::uint8_t, 2> fired, In<std::int32_t, 2> rows, In<std::int32_t, 1> start,
             bool near_start) -> Tuple<Array<std::int32_t>, bool, std::uint32_t, std::uint32_t, std::uint32_t, double> {
            const Columns columns = columns_of(azimuth, fired);
            const BeamTable table = table_of(rows);
            if (ranges.shape(0) != kRows || ranges.shape(1) != columns.width)
              throw Error(ErrorCode::Section, "ranges are (64, W), as wide as the columns");
            const Motion from = motion_of(start);
            lidarcodec::FoundMotion result;
            {
              nb::gil_scoped_release release;
              result = lidarcodec::find_motion(self, ranges.data(), columns, table, from, near_start);
            }
            std::vector<std::int32_t> numbers(result.motion.rotation.begin(), result.motion.rotation.end());
            numbers.insert(numbers.end(), result.motion.translation.begin(), result.motion.translation.end());
            return nb::make_tuple(give(std::move(numbers), {12}), result.found, result.points, result.matched,
                                  result.iterations, result.median_m);
          },
          nb::arg("ranges").noconvert(), nb::arg("azimuth").noconvert(), nb::arg("fired").noconvert(),
          nb::arg("rows").noconvert(), nb::arg("start").noconvert(), nb::arg("near_start") = false,
          "Motion since a turn ago: its 12 numbers, whether it was found, points tried, points matched, iterations, "
          "and the median "
          "distance of matched points in metres. near_start: a prior holds it near `start`.");
}
