#include "base/error.hpp"
#include "bindings.hpp"
#include "frame_arrays.hpp"
#include "geometry.hpp"
#include "mask/coder.hpp"
#include "mask/stream.hpp"
#include "planes/keep_coder.hpp"

namespace {

using lidarcodec::EarlierMask;
using lidarcodec::kMaskRows;
using lidarcodec::MaskGeometry;

EarlierMask earlier_of(const In<std::uint8_t, 2>& earlier) {
  if (earlier.shape(0) != kMaskRows)
    throw lidarcodec::Error(lidarcodec::ErrorCode::Section, "an earlier mask has 64 rows");
  return {earlier.data(), earlier.shape(1)};
}

const std::uint16_t* azimuths_of(const In<std::uint16_t, 2>& azimuth, const MaskGeometry& geometry) {
  if (azimuth.shape(0) != 2 || azimuth.shape(1) != geometry.width)
    throw lidarcodec::Error(lidarcodec::ErrorCode::Section, "azimuths are (2, W), as wide as the columns");
  return azimuth.data();
}

}  // namespace

void bind_mask(nb::module_& m) {
  m.def(
      "encode_mask",
      [](In<std::uint8_t, 2> mask, In<std::uint8_t, 2> fired, In<std::uint8_t, 1> half, In<std::int32_t, 1> rotation,
         In<std::uint8_t, 2> earlier, std::uint32_t turn) {
        const MaskGeometry geometry = geometry_of(fired, half, rotation);
        const EarlierMask before = earlier_of(earlier);
        if (mask.shape(0) != kMaskRows || mask.shape(1) != geometry.width) {
          throw lidarcodec::Error(lidarcodec::ErrorCode::Section, "a mask is (64, W), as wide as the columns");
        }
        std::vector<std::uint8_t> data;
        {
          nb::gil_scoped_release release;
          data = lidarcodec::encode_mask(mask.data(), geometry, before, turn);
        }
        return give_bytes(data);
      },
      nb::arg("mask").noconvert(), nb::arg("fired").noconvert(), nb::arg("half").noconvert(),
      nb::arg("rotation").noconvert(), nb::arg("earlier").noconvert(), nb::arg("turn"),
      "Bytes of a mask; `earlier` is (64, 0) for none; `turn`: columns in a full turn, 0 to find it from the mask.");
  m.def(
      "decode_mask",
      [](nb::bytes data, In<std::uint8_t, 2> fired, In<std::uint8_t, 1> half, In<std::int32_t, 1> rotation,
         In<std::uint8_t, 2> earlier) {
        const MaskGeometry geometry = geometry_of(fired, half, rotation);
        const EarlierMask before = earlier_of(earlier);
        const std::uint8_t* bytes = data_of(data);
        const std::size_t size = data.size();
        std::vector<std::uint8_t> mask;
        {
          nb::gil_scoped_release release;
          mask = lidarcodec::decode_mask(bytes, size, geometry, before);
        }
        return give(std::move(mask), {kMaskRows, geometry.width});
      },
      nb::arg("data"), nb::arg("fired").noconvert(), nb::arg("half").noconvert(), nb::arg("rotation").noconvert(),
      nb::arg("earlier").noconvert(), "(64, W) uint8 of 0 and 1.");
  m.def(
      "encode_keep",
      [](In<std::uint8_t, 2> keep, In<std::uint16_t, 2> azimuth, In<std::uint8_t, 2> fired, In<std::uint8_t, 1> half,
         In<std::int32_t, 1> rotation, In<std::uint8_t, 2> earlier) {
        const MaskGeometry geometry = geometry_of(fired, half, rotation);
        const EarlierMask before = earlier_of(earlier);
        const std::uint16_t* at = azimuths_of(azimuth, geometry);
        if (keep.shape(0) != kMaskRows || keep.shape(1) != geometry.width)
          throw lidarcodec::Error(lidarcodec::ErrorCode::Section, "a mask is (64, W), as wide as the columns");
        std::vector<std::uint8_t> data;
        {
          nb::gil_scoped_release release;
          data = lidarcodec::encode_keep(keep.data(), geometry, at, before);
        }
        return give_bytes(data);
      },
      nb::arg("keep").noconvert(), nb::arg("azimuth").noconvert(), nb::arg("fired").noconvert(),
      nb::arg("half").noconvert(), nb::arg("rotation").noconvert(), nb::arg("earlier").noconvert(),
      "Bytes of a keep mask with few cells set; `earlier` is (64, W), or (64, 0) for none.");
  m.def(
      "decode_keep",
      [](nb::bytes data, In<std::uint16_t, 2> azimuth, In<std::uint8_t, 2> fired, In<std::uint8_t, 1> half,
         In<std::int32_t, 1> rotation, In<std::uint8_t, 2> earlier) {
        const MaskGeometry geometry = geometry_of(fired, half, rotation);
        const EarlierMask before = earlier_of(earlier);
        const std::uint16_t* at = azimuths_of(azimuth, geometry);
        const std::uint8_t* bytes = data_of(data);
        const std::size_t size = data.size();
        std::vector<std::uint8_t> keep;
        {
          nb::gil_scoped_release release;
          keep = lidarcodec::decode_keep(bytes, size, geometry, at, before);
        }
        return give(std::move(keep), {kMaskRows, geometry.width});
      },
      nb::arg("data"), nb::arg("azimuth").noconvert(), nb::arg("fired").noconvert(), nb::arg("half").noconvert(),
      nb::arg("rotation").noconvert(), nb::arg("earlier").noconvert(), "(64, W) uint8 of 0 and 1.");
}
namespace {

using lidarcodec::Error;
using lidarcodec::ErrorCode;
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
      .def(
          "copy", [](const MaskStream& stream) { return MaskStream(stream); },
          "Another one, which goes on from the same state.")
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
