#include <nanobind/stl/vector.h>

#include "base/error.hpp"
#include "bindings.hpp"
#include "maps/points.hpp"

namespace {

using lidarcodec::Error;
using lidarcodec::ErrorCode;
using lidarcodec::TileForm;
using lidarcodec::TilePoints;

TileForm form_of(unsigned levels, std::uint32_t cell, std::uint32_t reach, const std::vector<unsigned>& bits) {
  return {levels, cell, reach, bits};
}

}  // namespace

void bind_maps(nb::module_& m) {
  m.def(
      "encode_tile",
      [](In<std::uint32_t, 2> points, In<std::uint16_t, 2> values, unsigned levels, std::uint32_t cell,
         std::uint32_t reach, std::vector<unsigned> bits) {
        const std::size_t count = points.shape(0);
        if (points.shape(1) != 3 || values.shape(0) != count || values.shape(1) != bits.size())
          throw Error(ErrorCode::Settings, "points are (N, 3), values (N, columns)");
        std::vector<std::uint8_t> data;
        {
          nb::gil_scoped_release release;
          TilePoints tile;
          tile.points.resize(count);
          for (std::size_t i = 0; i < 3 * count; ++i) tile.points[i / 3][i % 3] = points.data()[i];
          tile.values.assign(values.data(), values.data() + values.size());
          data = lidarcodec::encode_tile(tile, form_of(levels, cell, reach, bits));
        }
        return give_bytes(data);
      },
      nb::arg("points").noconvert(), nb::arg("values").noconvert(), nb::arg("levels"), nb::arg("cell"),
      nb::arg("reach"), nb::arg("bits"),
      "Bytes of the points of a tile, with a column of values for each number in `bits`.");
  m.def(
      "decode_tile",
      [](nb::bytes data, std::size_t count, unsigned levels, std::uint32_t cell, std::uint32_t reach,
         std::vector<unsigned> bits) {
        const std::uint8_t* bytes = data_of(data);
        const std::size_t size = data.size(), columns = bits.size();
        TilePoints tile;
        std::vector<std::uint32_t> points;
        {
          nb::gil_scoped_release release;
          tile = lidarcodec::decode_tile({bytes, size}, count, form_of(levels, cell, reach, bits));
          points.reserve(3 * count);
          for (const auto& point : tile.points) points.insert(points.end(), point.begin(), point.end());
        }
        return Tuple<Array<std::uint32_t>, Array<std::uint16_t>>(
            nb::make_tuple(give(std::move(points), {count, 3}), give(std::move(tile.values), {count, columns})));
      },
      nb::arg("data"), nb::arg("count"), nb::arg("levels"), nb::arg("cell"), nb::arg("reach"), nb::arg("bits"),
      "(N, 3) uint32 points and (N, columns) uint16 values of a tile.");
}
