#include "base/error.hpp"
#include "bindings.hpp"
#include "bits/number_series.hpp"
#include "bits/numbers.hpp"
#include "planes/azimuth_coder.hpp"

namespace {

std::vector<std::size_t> counts_of(const In<std::uint64_t, 1>& counts) {
  return {counts.data(), counts.data() + counts.shape(0)};
}

}  // namespace

void bind_entropy(nb::module_& m) {
  m.def(
      "encode_numbers",
      [](In<std::uint64_t, 1> values, In<std::uint64_t, 1> counts) {
        const std::vector<std::size_t> streams = counts_of(counts);
        std::size_t left = values.shape(0);
        for (const std::size_t count : streams) {
          if (count > left)
            throw lidarcodec::Error(lidarcodec::ErrorCode::Section, "streams of more numbers than were given");
          left -= count;
        }
        std::vector<std::uint8_t> data;
        {
          nb::gil_scoped_release release;
          data = lidarcodec::encode_numbers(values.data(), streams);
        }
        return give_bytes(data);
      },
      nb::arg("values").noconvert(), nb::arg("counts").noconvert(),
      "Bytes of streams of `counts` numbers, one after the other.");
  m.def(
      "decode_numbers",
      [](nb::bytes data, In<std::uint64_t, 1> counts) {
        const std::vector<std::size_t> streams = counts_of(counts);
        constexpr std::size_t most = std::size_t{1} << 20;
        std::size_t total = 0;
        for (const std::size_t count : streams) {
          if (count > most - total)
            throw lidarcodec::Error(lidarcodec::ErrorCode::Section, "streams of more than 2^20 numbers");
          total += count;
        }
        const std::uint8_t* bytes = data_of(data);
        const std::size_t size = data.size();
        std::vector<std::uint64_t> values;
        {
          nb::gil_scoped_release release;
          values = lidarcodec::decode_numbers(bytes, size, streams);
        }
        return give(std::move(values), {total});
      },
      nb::arg("data"), nb::arg("counts").noconvert(), "uint64 numbers of all streams; at most 2^20.");
  m.def(
      "best_form",
      [](In<std::int64_t, 1> values,
         std::int64_t modulus) -> Tuple<int, std::int64_t, std::int64_t, Array<std::int64_t>, std::uint64_t> {
        if (modulus < 0) throw lidarcodec::Error(lidarcodec::ErrorCode::Section, "a modulus below 0");
        lidarcodec::SeriesFit fit;
        {
          nb::gil_scoped_release release;
          fit = lidarcodec::best_form({values.data(), values.data() + values.shape(0)}, modulus);
        }
        return nb::make_tuple(static_cast<int>(fit.form), fit.level, fit.rate,
                              give(std::move(fit.residuals), {values.shape(0)}), fit.cost);
      },
      nb::arg("values").noconvert(), nb::arg("modulus"),
      "The number of the form, level and rate of its line, the residuals (N,) int64, and their cost in 1/256 bit.");
  m.def(
      "best_period",
      [](In<std::uint8_t, 1> types, std::size_t longest) {
        nb::gil_scoped_release release;
        return lidarcodec::best_period(types.data(), types.shape(0), longest);
      },
      nb::arg("types").noconvert(), nb::arg("longest"), "The period, 1 to `longest`, that predicts the most types.");
  m.def(
      "encode_azimuth",
      [](In<std::uint16_t, 2> azimuth, In<std::uint8_t, 2> fired) {
        const std::size_t width = azimuth.shape(1);
        if (azimuth.shape(0) != 2 || fired.shape(0) != 2 || fired.shape(1) != width) {
          throw lidarcodec::Error(lidarcodec::ErrorCode::Section, "azimuth and fired are both (2, W)");
        }
        std::vector<std::uint8_t> data;
        {
          nb::gil_scoped_release release;
          data = lidarcodec::encode_azimuth(azimuth.data(), fired.data(), width);
        }
        return give_bytes(data);
      },
      nb::arg("azimuth").noconvert(), nb::arg("fired").noconvert(), "Bytes of the azimuths of a frame, (2, W).");
  m.def(
      "decode_azimuth",
      [](nb::bytes data, std::size_t width) -> Tuple<Array<std::uint16_t>, Array<std::uint8_t>> {
        if (width > std::size_t{1} << 20)
          throw lidarcodec::Error(lidarcodec::ErrorCode::Section, "a frame of more than 2^20 columns");
        const std::uint8_t* bytes = data_of(data);
        const std::size_t size = data.size();
        lidarcodec::Azimuths decoded;
        {
          nb::gil_scoped_release release;
          decoded = lidarcodec::decode_azimuth(bytes, size, width);
        }
        return nb::make_tuple(give(std::move(decoded.azimuth), {2, width}), give(std::move(decoded.fired), {2, width}));
      },
      nb::arg("data"), nb::arg("width"), "azimuth (2, W) uint16 and fired (2, W) uint8.");
  m.def(
      "columns_in_turn",
      [](In<std::uint16_t, 1> rotations) {
        nb::gil_scoped_release release;
        return lidarcodec::columns_in_turn(rotations.data(), rotations.shape(0));
      },
      nb::arg("rotations").noconvert(),
      "Columns in a full turn, from the mean step of azimuths (W,); 0: the sensor does not rotate.");
}
