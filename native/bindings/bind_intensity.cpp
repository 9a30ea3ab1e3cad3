#include <nanobind/stl/optional.h>

#include <optional>

#include "base/error.hpp"
#include "bindings.hpp"
#include "geometry.hpp"
#include "planes/intensity_choice.hpp"
#include "planes/intensity_coder.hpp"

namespace {

using lidarcodec::IntensityMemory;
using lidarcodec::kMaskRows;
using lidarcodec::MaskGeometry;

void expect_image(const In<std::uint8_t, 2>& image, const MaskGeometry& geometry) {
  if (image.shape(0) != kMaskRows || image.shape(1) != geometry.width)
    throw lidarcodec::Error(lidarcodec::ErrorCode::Section,
                            "intensities and returns are (64, W), as wide as the columns");
}

// The angles of (2, W) halves, or nullptr.
const std::uint16_t* angles_of(const std::optional<In<std::uint16_t, 2>>& azimuth, const MaskGeometry& geometry) {
  if (!azimuth) return nullptr;
  if (azimuth->shape(0) != 2 || azimuth->shape(1) != geometry.width)
    throw lidarcodec::Error(lidarcodec::ErrorCode::Section, "azimuths are (2, W), as wide as the columns");
  return azimuth->data();
}

}  // namespace

void bind_intensity(nb::module_& m) {
  nb::class_<IntensityMemory>(m, "IntensityMemory")
      .def(
          "__init__",
          [](IntensityMemory* self, bool follows) {
            new (self) IntensityMemory;
            self->follows = follows;
          },
          nb::arg("follows") = false,
          "What sections taught the coder of intensities; of none yet. `follows`: frames go on from each other, beside "
          "the parts of a turn.")
      .def(
          "copy", [](const IntensityMemory& self) { return IntensityMemory(self); }, "The same once more.")
      .def("forget_models", &lidarcodec::forget_models, "The next section begins anew.");
  m.def(
      "encode_intensity",
      [](In<std::uint8_t, 2> values, In<std::uint8_t, 2> returns, In<std::uint8_t, 2> fired, In<std::uint8_t, 1> half,
         In<std::int32_t, 1> rotation, std::uint32_t turn, IntensityMemory* memory,
         std::optional<In<std::uint16_t, 2>> azimuth) {
        const MaskGeometry geometry = geometry_of(fired, half, rotation);
        expect_image(values, geometry);
        expect_image(returns, geometry);
        const std::uint16_t* const angles = angles_of(azimuth, geometry);
        std::vector<std::uint8_t> data;
        {
          nb::gil_scoped_release release;
          data = lidarcodec::encode_intensity(values.data(), returns.data(), geometry, turn, memory, angles);
        }
        return give_bytes(data);
      },
      nb::arg("values").noconvert(), nb::arg("returns").noconvert(), nb::arg("fired").noconvert(),
      nb::arg("half").noconvert(), nb::arg("rotation").noconvert(), nb::arg("turn"),
      nb::arg("memory").none() = nb::none(), nb::arg("azimuth").noconvert().none() = nb::none(),
      "Bytes of the intensities of the returns; `turn`: columns in a full turn, 0 to find it from the returns; "
      "`memory`: what to go on from, changed; `azimuth`: (2, W), of a memory that follows frames.");
  m.def(
      "choose_levels",
      [](In<std::uint8_t, 2> values, In<std::uint8_t, 2> returns, In<std::uint8_t, 2> fired, In<std::uint8_t, 1> half,
         In<std::int32_t, 1> rotation, std::uint32_t levels) {
        const MaskGeometry geometry = geometry_of(fired, half, rotation);
        expect_image(values, geometry);
        expect_image(returns, geometry);
        std::vector<std::uint8_t> image;
        {
          nb::gil_scoped_release release;
          image = lidarcodec::choose_levels(values.data(), returns.data(), geometry, levels);
        }
        return give(std::move(image), {kMaskRows, geometry.width});
      },
      nb::arg("values").noconvert(), nb::arg("returns").noconvert(), nb::arg("fired").noconvert(),
      nb::arg("half").noconvert(), nb::arg("rotation").noconvert(), nb::arg("levels"),
      "(64, W) uint8 with at most `levels` values that minimise error and bits; 0 outside of the returns.");
  m.def(
      "decode_intensity",
      [](nb::bytes data, In<std::uint8_t, 2> returns, In<std::uint8_t, 2> fired, In<std::uint8_t, 1> half,
         In<std::int32_t, 1> rotation, IntensityMemory* memory, std::optional<In<std::uint16_t, 2>> azimuth) {
        const MaskGeometry geometry = geometry_of(fired, half, rotation);
        expect_image(returns, geometry);
        const std::uint16_t* const angles = angles_of(azimuth, geometry);
        const std::uint8_t* bytes = data_of(data);
        const std::size_t size = data.size();
        std::vector<std::uint8_t> values;
        {
          nb::gil_scoped_release release;
          values = lidarcodec::decode_intensity(bytes, size, returns.data(), geometry, memory, angles);
        }
        return give(std::move(values), {kMaskRows, geometry.width});
      },
      nb::arg("data"), nb::arg("returns").noconvert(), nb::arg("fired").noconvert(), nb::arg("half").noconvert(),
      nb::arg("rotation").noconvert(), nb::arg("memory").none() = nb::none(),
      nb::arg("azimuth").noconvert().none() = nb::none(),
      "(64, W) uint8, 0 outside of the returns; `memory`, `azimuth`: as the encoder was given.");
}
