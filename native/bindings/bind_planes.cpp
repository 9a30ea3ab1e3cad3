#include <nanobind/stl/vector.h>

#include <utility>

#include "base/error.hpp"
#include "bindings.hpp"
#include "images/coder.hpp"
#include "images/following.hpp"

namespace lc = lidarcodec;

namespace {

lc::PlaneFrame frame_of(std::size_t rows, std::size_t columns, const In<std::uint8_t, 2>& forms,
                        const In<std::int32_t, 1>& shift, std::uint32_t step) {
  if (forms.shape(1) != 4) throw lc::Error(lc::ErrorCode::Settings, "forms of planes are (P, 4)");
  if (forms.shape(0) > lc::kMostPlanes) throw lc::Error(lc::ErrorCode::Settings, "a frame has 1 to 32 planes");
  lc::PlaneFrame frame;
  frame.rows = rows;
  frame.columns = columns;
  frame.shift.assign(shift.data(), shift.data() + shift.shape(0));
  frame.step = step;
  for (std::size_t i = 0; i < forms.shape(0); ++i) {
    const std::uint8_t* form = forms.data() + 4 * i;
    if (form[0] > static_cast<std::uint8_t>(lc::PlaneRole::Attribute))
      throw lc::Error(lc::ErrorCode::Settings, "a plane has a role of 0 to 2");
    frame.planes.push_back({static_cast<lc::PlaneRole>(form[0]), form[1], form[2], form[3]});
  }
  return frame;
}

// Read-only, (H, W), C-contiguous, of unsigned integers of 8, 16 or 32 bits.
using AnyPlane = nb::ndarray<nb::ro, nb::ndim<2>, nb::c_contig, nb::device::cpu>;

template <typename T>
bool append_if(std::vector<lc::PlaneImage>& images, const AnyPlane& plane) {
  if (plane.dtype() != nb::dtype<T>()) return false;
  const T* const cells = static_cast<const T*>(plane.data());
  images.emplace_back(cells, cells + plane.size());
  return true;
}

// Images of planes. Raises Settings unless all have one shape.
std::vector<lc::PlaneImage> images_of(const std::vector<AnyPlane>& planes, const lc::PlaneFrame& frame) {
  std::vector<lc::PlaneImage> images;
  for (const AnyPlane& plane : planes) {
    if (plane.shape(0) != frame.rows || plane.shape(1) != frame.columns)
      throw lc::Error(lc::ErrorCode::Settings, "planes have one shape, (H, W), and one shift for each row");
    if (!append_if<std::uint8_t>(images, plane) && !append_if<std::uint16_t>(images, plane) &&
        !append_if<std::uint32_t>(images, plane))
      throw lc::Error(lc::ErrorCode::Settings, "planes are arrays of uint8, uint16 or uint32");
  }
  return images;
}

nb::list give_images(std::vector<lc::PlaneImage>&& images, const lc::PlaneFrame& frame) {
  nb::list result;
  for (lc::PlaneImage& image : images) result.append(give(std::move(image), {frame.rows, frame.columns}));
  return result;
}

std::vector<lc::ColumnRun> runs_of(const In<std::uint32_t, 2>& runs) {
  if (runs.shape(1) != 2) throw lc::Error(lc::ErrorCode::Settings, "runs of columns are (N, 2)");
  std::vector<lc::ColumnRun> found;
  for (std::size_t i = 0; i < runs.shape(0); ++i) found.push_back({runs.data()[2 * i], runs.data()[2 * i + 1]});
  return found;
}

// beams: (H, 2) up and aside; of no rows: nothing is known.
lc::SensorView view_of(const In<std::int32_t, 2>& beams, const In<std::uint16_t, 1>& azimuth, double metre) {
  if (beams.shape(1) != 2) throw lc::Error(lc::ErrorCode::Settings, "beams are (H, 2)");
  lc::SensorView view{{}, {azimuth.data(), azimuth.data() + azimuth.size()}, metre};
  for (std::size_t row = 0; row < beams.shape(0); ++row) {
    view.beams.up.push_back(beams.data()[2 * row]);
    view.beams.aside.push_back(beams.data()[2 * row + 1]);
  }
  return view;
}

}  // namespace

void bind_planes(nb::module_& m) {
  m.def(
      "encode_planes",
      [](const std::vector<AnyPlane>& planes, In<std::uint8_t, 2> forms, In<std::int32_t, 1> shift, std::uint32_t step,
         bool quick) {
        const lc::PlaneFrame frame =
            frame_of(shift.shape(0), planes.empty() ? 0 : planes[0].shape(1), forms, shift, step);
        lc::check_frame(frame);
        const std::vector<lc::PlaneImage> images = images_of(planes, frame);
        std::vector<std::uint8_t> data;
        {
          nb::gil_scoped_release release;
          data = lc::encode_planes(frame, images, quick);
        }
        return give_bytes(data);
      },
      nb::arg("planes").noconvert(), nb::arg("forms").noconvert(), nb::arg("shift").noconvert(), nb::arg("step"),
      nb::arg("quick"),
      "Bytes of P planes, (H, W) uint8, uint16 or uint32 each. forms: (P, 4) role, bits, of, like; shift: (H,) "
      "columns.");
  m.def(
      "decode_planes",
      [](nb::bytes data, std::size_t columns, In<std::uint8_t, 2> forms, In<std::int32_t, 1> shift,
         std::uint32_t step) -> List<Array<std::uint32_t>> {
        const lc::PlaneFrame frame = frame_of(shift.shape(0), columns, forms, shift, step);
        const std::uint8_t* bytes = data_of(data);
        const std::size_t size = data.size();
        std::vector<lc::PlaneImage> images;
        {
          nb::gil_scoped_release release;
          images = lc::decode_planes(bytes, size, frame);
        }
        return List<Array<std::uint32_t>>(give_images(std::move(images), frame));
      },
      nb::arg("data"), nb::arg("columns"), nb::arg("forms").noconvert(), nb::arg("shift").noconvert(), nb::arg("step"),
      "P planes, (H, W) uint32 each.");
  nb::class_<lc::PlaneMemory>(m, "PlaneMemory", "What a stream of planes remembers from frame to frame.")
      .def(nb::init<>())
      .def("forget", &lc::PlaneMemory::forget, "Begin from nothing.")
      .def_prop_ro("columns", &lc::PlaneMemory::columns, "Columns of the frame before; 0: there is none.")
      .def(
          "encode",
          [](lc::PlaneMemory& memory, const std::vector<AnyPlane>& planes, In<std::uint8_t, 2> forms,
             In<std::int32_t, 1> shift, std::uint32_t step, In<std::uint32_t, 2> runs, In<std::int32_t, 2> beams,
             In<std::uint16_t, 1> azimuth, double metre) {
            const lc::PlaneFrame frame =
                frame_of(shift.shape(0), planes.empty() ? 0 : planes[0].shape(1), forms, shift, step);
            lc::check_frame(frame);
            const std::vector<lc::PlaneImage> images = images_of(planes, frame);
            const std::vector<lc::ColumnRun> found = runs_of(runs);
            const lc::SensorView view = view_of(beams, azimuth, metre);
            std::vector<std::uint8_t> data;
            {
              nb::gil_scoped_release release;
              data = lc::encode_next_planes(memory, frame, images, found, view);
            }
            return give_bytes(data);
          },
          nb::arg("planes").noconvert(), nb::arg("forms").noconvert(), nb::arg("shift").noconvert(), nb::arg("step"),
          nb::arg("runs").noconvert(), nb::arg("beams").noconvert(), nb::arg("azimuth").noconvert(), nb::arg("metre"),
          "Bytes of the next frame. runs: (N, 2) uint32, numbers of columns and their first column in the frame "
          "before; beams: (H, 2) int32, up and aside in steps of 2^-20 of a turn, (0, 2): unknown; azimuth: (W,), 0.01 "
          "degree; metre: ranges in a metre.")
      .def(
          "decode",
          [](lc::PlaneMemory& memory, nb::bytes data, std::size_t columns, In<std::uint8_t, 2> forms,
             In<std::int32_t, 1> shift, std::uint32_t step) -> List<Array<std::uint32_t>> {
            const lc::PlaneFrame frame = frame_of(shift.shape(0), columns, forms, shift, step);
            const std::uint8_t* bytes = data_of(data);
            const std::size_t size = data.size();
            std::vector<lc::PlaneImage> images;
            {
              nb::gil_scoped_release release;
              images = lc::decode_next_planes(memory, bytes, size, frame);
            }
            return List<Array<std::uint32_t>>(give_images(std::move(images), frame));
          },
          nb::arg("data"), nb::arg("columns"), nb::arg("forms").noconvert(), nb::arg("shift").noconvert(),
          nb::arg("step"), "The next frame: P planes, (H, W) uint32 each.");
}
