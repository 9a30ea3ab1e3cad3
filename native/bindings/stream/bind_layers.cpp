#include "base/error.hpp"
#include "bindings.hpp"
#include "geometry.hpp"
#include "layers/range_refiner.hpp"

namespace {

using lidarcodec::kMaskRows;
using lidarcodec::LayerImage;
using lidarcodec::LayerSteps;
using lidarcodec::MaskGeometry;

LayerImage image_of(const MaskGeometry& geometry, const In<std::uint16_t, 2>& base, const In<std::int32_t, 1>& level) {
  if (base.shape(0) != kMaskRows || base.shape(1) != geometry.width || level.shape(0) != kMaskRows)
    throw lidarcodec::Error(lidarcodec::ErrorCode::Section,
                            "a base is (64, W), as wide as the columns, with 64 levels");
  return {geometry, base.data(), level.data()};
}

}  // namespace

void bind_layers(nb::module_& m) {
  m.def(
      "encode_refinement",
      [](In<std::uint16_t, 2> ranges, In<std::uint16_t, 2> base, In<std::uint8_t, 2> fired, In<std::uint8_t, 1> half,
         In<std::int32_t, 1> rotation, In<std::int32_t, 1> level, std::uint32_t base_step, std::uint32_t fine_step,
         std::uint32_t turn) {
        const MaskGeometry geometry = geometry_of(fired, half, rotation);
        const LayerImage image = image_of(geometry, base, level);
        if (ranges.shape(0) != kMaskRows || ranges.shape(1) != geometry.width)
          throw lidarcodec::Error(lidarcodec::ErrorCode::Section, "ranges and their base have one shape");
        std::vector<std::uint8_t> data;
        {
          nb::gil_scoped_release release;
          data = lidarcodec::encode_refinement(image, ranges.data(), LayerSteps{base_step, fine_step, turn});
        }
        return give_bytes(data);
      },
      nb::arg("ranges").noconvert(), nb::arg("base").noconvert(), nb::arg("fired").noconvert(),
      nb::arg("half").noconvert(), nb::arg("rotation").noconvert(), nb::arg("level").noconvert(), nb::arg("base_step"),
      nb::arg("fine_step"), nb::arg("turn"), "Bytes of the ranges at the returns of their base.");
  m.def(
      "decode_refinement",
      [](nb::bytes data, In<std::uint16_t, 2> base, In<std::uint8_t, 2> fired, In<std::uint8_t, 1> half,
         In<std::int32_t, 1> rotation, In<std::int32_t, 1> level, std::uint32_t base_step, std::uint32_t fine_step,
         std::uint32_t turn) {
        const MaskGeometry geometry = geometry_of(fired, half, rotation);
        const LayerImage image = image_of(geometry, base, level);
        const std::uint8_t* bytes = data_of(data);
        const std::size_t size = data.size();
        std::vector<std::uint16_t> ranges;
        {
          nb::gil_scoped_release release;
          ranges = lidarcodec::decode_refinement(bytes, size, image, LayerSteps{base_step, fine_step, turn});
        }
        return give(std::move(ranges), {kMaskRows, geometry.width});
      },
      nb::arg("data"), nb::arg("base").noconvert(), nb::arg("fired").noconvert(), nb::arg("half").noconvert(),
      nb::arg("rotation").noconvert(), nb::arg("level").noconvert(), nb::arg("base_step"), nb::arg("fine_step"),
      nb::arg("turn"), "(64, W) uint16, 0 outside of the returns.");
}
