#include <nanobind/stl/optional.h>

#include <memory>
#include <optional>

#include "base/error.hpp"
#include "bindings.hpp"
#include "geometry.hpp"
#include "predictive/coder.hpp"
#include "range_images.hpp"

using lidarcodec::kMaskRows;
using lidarcodec::MaskGeometry;
using lidarcodec::PredictiveCoder;
using lidarcodec::RiddleNets;

namespace {

// Releases the Python object that owns the networks.
struct Release {
  PyObject* object;
  void operator()(const RiddleNets*) const noexcept {
    if (!nb::is_alive()) return;
    const nb::gil_scoped_acquire held;
    Py_DECREF(object);
  }
};

// Networks shared with Python. nanobind's own caster (nanobind/stl/shared_ptr.h) makes a shared_ptr in a noexcept
// function, and so ends the process when memory is short.
std::shared_ptr<const RiddleNets> shared(nb::handle nets) {
  if (nets.is_none()) return nullptr;
  const auto* const found = nb::cast<const RiddleNets*>(nets);
  return {found, Release{nets.inc_ref().ptr()}};  // a shared_ptr that cannot be made calls Release
}

// Where the sent ranges go, (64, W); nullptr for (64, 0).
std::uint16_t* sent_of(const nb::ndarray<std::uint16_t, nb::ndim<2>, nb::c_contig, nb::device::cpu>& sent,
                       const MaskGeometry& geometry) {
  if (sent.shape(1) == 0) return nullptr;
  if (sent.shape(0) != kMaskRows || sent.shape(1) != geometry.width)
    throw lidarcodec::Error(lidarcodec::ErrorCode::Section, "what is sent is (64, W), as wide as the columns");
  return sent.data();
}

}  // namespace

void bind_predictive(nb::module_& m) {
  m.def(
      "coding_paths",
      []() -> List<nb::str> {
        nb::list names;
        for (const lidarcodec::Path path : lidarcodec::paths_here()) names.append(lidarcodec::name_of(path));
        return names;
      },
      "The paths that this processor can run, the fastest last.");
  m.def("has_free_processor", &lidarcodec::has_free_processor,
        "Whether one more thread would find a processor that is free, or nearly.");
  m.def(
      "known_columns", [](nb::bytes data) { return lidarcodec::known_columns(data_of(data), data.size()); },
      nb::arg("data"),
      "The number of known columns that the bytes of a slab need; -1 for a whole frame, or without returns.");
  nb::class_<PredictiveCoder>(m, "PredictiveCoder")
      .def(
          "__init__",
          [](PredictiveCoder* coder, const char* path, nb::handle nets, std::optional<bool> at_once) {
            new (coder) PredictiveCoder(*path == 0 ? lidarcodec::quickest_path() : lidarcodec::path_named(path),
                                        shared(nets), at_once);
          },
          nb::arg("path") = "", nb::arg("nets").none() = nb::none(), nb::arg("at_once").none() = nb::none(),
          "path: one of `coding_paths`, by default the fastest. nets: RiddleNets, or None. at_once: whether two "
          "threads code halves; None: if it pays. Bytes depend on neither path nor at_once.")
      .def(
          "change", [](PredictiveCoder& coder, nb::handle nets) { coder.change(shared(nets)); }, nb::arg("nets"),
          "Replaces the networks; the state of the contexts stays.")
      .def(
          "copy", [](const PredictiveCoder& coder) { return PredictiveCoder(coder); },
          "Another one, which goes on from the same state.")
      .def("reset", &PredictiveCoder::reset, "Returns all models to their initial state.")
      .def(
          "encode",
          [](PredictiveCoder& coder, In<std::uint16_t, 2> ranges, In<std::uint8_t, 2> returns, std::uint32_t step,
             In<std::int32_t, 1> level, In<std::uint8_t, 2> fired, In<std::uint8_t, 1> half,
             In<std::int32_t, 1> rotation, std::uint32_t turn, std::uint32_t firing, In<std::uint16_t, 2> expected,
             std::int64_t known, lidarcodec::RiddleSamples* samples, bool quick,
             nb::ndarray<std::uint16_t, nb::ndim<2>, nb::c_contig, nb::device::cpu> sent, bool halves) {
            const MaskGeometry geometry = geometry_of(fired, half, rotation);
            expect_image(ranges, geometry);
            expect_image(returns, geometry);
            const lidarcodec::RangeCells cells = cells_of(step, level);
            const std::uint16_t* const seen = expectation(expected, geometry);
            std::uint16_t* const to = sent_of(sent, geometry);
            std::vector<std::uint8_t> data;
            {
              nb::gil_scoped_release release;
              data = coder.encode(ranges.data(), returns.data(), cells, geometry, turn, firing, seen, known, samples,
                                  quick, to, halves);
            }
            return give_bytes(data);
          },
          nb::arg("ranges").noconvert(), nb::arg("returns").noconvert(), nb::arg("step"), nb::arg("level").noconvert(),
          nb::arg("fired").noconvert(), nb::arg("half").noconvert(), nb::arg("rotation").noconvert(), nb::arg("turn"),
          nb::arg("firing"), nb::arg("expected").noconvert(), nb::arg("known"), nb::arg("samples").none(),
          nb::arg("quick"), nb::arg("sent").noconvert(), nb::arg("halves"),
          "Bytes of the ranges of the returns. turn: columns in a full turn, 0 to find it from the returns; firing: of "
          "the first "
          "column; quick: with fewer contexts; sent: (64, W) gets free ranges as they are decoded, (64, 0): ranges are "
          "rounded; halves: of a whole frame, code it in halves.")
      .def(
          "decode",
          [](PredictiveCoder& coder, nb::bytes data, In<std::uint8_t, 2> returns, std::uint32_t step,
             In<std::int32_t, 1> level, In<std::uint8_t, 2> fired, In<std::uint8_t, 1> half,
             In<std::int32_t, 1> rotation, In<std::uint16_t, 2> expected, std::int64_t known,
             In<std::uint16_t, 2> before) {
            const MaskGeometry geometry = geometry_of(fired, half, rotation);
            expect_image(returns, geometry);
            const lidarcodec::RangeCells cells = cells_of(step, level);
            const std::uint16_t* const seen = expectation(expected, geometry);
            if (before.shape(0) != kMaskRows ||
                static_cast<std::int64_t>(before.shape(1)) != std::max<std::int64_t>(known, 0))
              throw lidarcodec::Error(lidarcodec::ErrorCode::Section, "known ranges are (64, known)");
            const std::uint8_t* bytes = data_of(data);
            const std::size_t size = data.size();
            std::vector<std::uint16_t> ranges;
            {
              nb::gil_scoped_release release;
              ranges = coder.decode(bytes, size, returns.data(), cells, geometry, seen, known, before.data());
            }
            return give(std::move(ranges), {kMaskRows, geometry.width});
          },
          nb::arg("data"), nb::arg("returns").noconvert(), nb::arg("step"), nb::arg("level").noconvert(),
          nb::arg("fired").noconvert(), nb::arg("half").noconvert(), nb::arg("rotation").noconvert(),
          nb::arg("expected").noconvert(), nb::arg("known"), nb::arg("before").noconvert(),
          "(64, W) uint16, 0 outside of the returns.");
}
