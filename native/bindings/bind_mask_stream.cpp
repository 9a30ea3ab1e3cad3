#include "base/error.hpp"
#include "bindings.hpp"
#include "frame_arrays.hpp"
#include "mask/stream.hpp"

namespace {

using lidarcodec::Error;
using lidarcodec::ErrorCode;
using lidarcodec::kMaskRows;
using lidarcodec::MaskStream;
using lidarcodec::MaskView;

// The view points into the arrays.
MaskView view_of(const In<std::uint16_t, 2>& azimuth, const In<std::uint8_t, 2>& fired,
                 const In<std::int32_t, 2>& beams, const In<std::uint16_t, 2>& expected,
                 const In<std::int32_t, 1>& motion) {
  const lidarcodec::Columns columns = columns_of(azimuth, fired);
  const lidarcodec::BeamTable table = table_of(beams);
  if (expected.shape(0) != kMaskRows || (expected.shape(1) != 0 && expected.shape(1) != columns.width))
    throw Error(ErrorCode::Section, "expected ranges are (64, W), or (64, 0) for none");
  if (motion.shape(0) != 12) throw Error(ErrorCode::Section, "a motion is 12 numbers");
  MaskView view;
  view.geometry.width = columns.width;
  view.geometry.fired = columns.fired;
  for (std::size_t row = 0; row < kMaskRows; ++row) {
    view.geometry.half[row] = table.half[row];
    view.geometry.rotation[row] = table.rotation[row];
  }
  view.azimuth = columns.azimuth;
  view.vertical = table.vertical;
  view.expected = expected.shape(1) == 0 ? nullptr : expected.data();
  for (std::size_t i = 0; i < 9; ++i) view.motion.rotation[i] = motion.data()[i];
  for (std::size_t i = 0; i < 3; ++i) view.motion.translation[i] = motion.data()[9 + i];
  return view;
}

}  // namespace

void bind_mask_stream(nb::module_& m) {
  nb::class_<MaskStream>(m, "MaskStream")
      .def(nb::init<>())
      .def("forget", &MaskStream::forget, "Returns all models to their initial state, and forgets all frames.")
      .def(
          "encode",
          [](MaskStream& stream, In<std::uint8_t, 2> mask, In<std::uint16_t, 2> azimuth, In<std::uint8_t, 2> fired,
             In<std::int32_t, 2> beams, In<std::uint16_t, 2> expected, In<std::int32_t, 1> motion) {
            const MaskView view = view_of(azimuth, fired, beams, expected, motion);
            if (mask.shape(0) != kMaskRows || mask.shape(1) != view.geometry.width)
              throw Error(ErrorCode::Section, "a mask is (64, W), as wide as the columns");
            std::vector<std::uint8_t> data;
            {
              nb::gil_scoped_release release;
              data = stream.encode(mask.data(), view);
            }
            return give_bytes(data);
          },
          nb::arg("mask").noconvert(), nb::arg("azimuth").noconvert(), nb::arg("fired").noconvert(),
          nb::arg("beams").noconvert(), nb::arg("expected").noconvert(), nb::arg("motion").noconvert(),
          "Bytes of a mask; `expected` is (64, 0) for nothing.")
      .def(
          "decode",
          [](MaskStream& stream, nb::bytes data, In<std::uint16_t, 2> azimuth, In<std::uint8_t, 2> fired,
             In<std::int32_t, 2> beams, In<std::uint16_t, 2> expected, In<std::int32_t, 1> motion) {
            const MaskView view = view_of(azimuth, fired, beams, expected, motion);
            const std::uint8_t* bytes = data_of(data);
            const std::size_t size = data.size();
            std::vector<std::uint8_t> mask;
            {
              nb::gil_scoped_release release;
              mask = stream.decode(bytes, size, view);
            }
            return give(std::move(mask), {kMaskRows, view.geometry.width});
          },
          nb::arg("data"), nb::arg("azimuth").noconvert(), nb::arg("fired").noconvert(), nb::arg("beams").noconvert(),
          nb::arg("expected").noconvert(), nb::arg("motion").noconvert(), "(64, W) uint8 of 0 and 1.");
}
