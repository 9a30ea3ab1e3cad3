#include <algorithm>

#include "base/error.hpp"
#include "bindings.hpp"
#include "ranges/holes.hpp"
#include "ranges/jpeg_writer.hpp"

namespace lc = lidarcodec;

namespace {

lc::StepTable steps_of(const In<std::uint16_t, 1>& given) {
  lc::StepTable table;
  if (given.shape(0) != table.size()) throw lc::Error(lc::ErrorCode::Settings, "a table of steps has 64 entries");
  std::copy_n(given.data(), table.size(), table.begin());
  return table;
}

template <typename T>
void expect_same(const In<T, 2>& values, const In<std::uint8_t, 2>& known) {
  if (values.shape(0) != known.shape(0) || values.shape(1) != known.shape(1))
    throw lc::Error(lc::ErrorCode::Settings, "an image and its mask must have the same sides");
}

}  // namespace

void bind_images(nb::module_& m) {
  m.def(
      "fill_blocks",
      [](In<float, 2> samples, In<std::uint8_t, 2> known, In<std::uint16_t, 1> steps, unsigned rounds) {
        expect_same(samples, known);
        if (rounds > 64) throw lc::Error(lc::ErrorCode::Settings, "at most 64 rounds of filling");
        const lc::StepTable table = steps_of(steps);
        const std::size_t rows = samples.shape(0), width = samples.shape(1);
        std::vector<float> image;
        {
          nb::gil_scoped_release release;
          image = lc::fill_blocks(samples.data(), known.data(), rows, width, table, rounds);
        }
        return give(std::move(image), {rows, width});
      },
      nb::arg("samples").noconvert(), nb::arg("known").noconvert(), nb::arg("steps").noconvert(), nb::arg("rounds"),
      "(H, W) float32, `samples` with the cells where `known`, (H, W) uint8, is 0 filled for JPEG with these 64 "
      "steps.");
  m.def(
      "fill_predicted",
      [](In<std::uint16_t, 2> values, In<std::uint8_t, 2> known) {
        expect_same(values, known);
        const std::size_t rows = values.shape(0), width = values.shape(1);
        std::vector<std::uint16_t> image;
        {
          nb::gil_scoped_release release;
          image.assign(values.data(), values.data() + rows * width);
          lc::fill_predicted(image.data(), known.data(), rows, width);
        }
        return give(std::move(image), {rows, width});
      },
      nb::arg("values").noconvert(), nb::arg("known").noconvert(),
      "(H, W) uint16, `values` with the cells where `known`, (H, W) uint8, is 0 filled by the clamped gradient.");
  m.def(
      "write_jpeg",
      [](In<float, 2> samples, In<std::uint16_t, 1> steps, unsigned bits) {
        const lc::StepTable table = steps_of(steps);
        const std::size_t rows = samples.shape(0), width = samples.shape(1);
        std::vector<std::uint8_t> file;
        {
          nb::gil_scoped_release release;
          file = lc::write_jpeg(samples.data(), rows, width, bits, table);
        }
        return give_bytes(file);
      },
      nb::arg("samples").noconvert(), nb::arg("steps").noconvert(), nb::arg("bits"),
      "A JPEG of one component, 8 or 12 bits, of (H, W) float32 samples, with these 64 steps, row by row.");
}
