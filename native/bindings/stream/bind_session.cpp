#include <nanobind/stl/optional.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/string_view.h>

#include <algorithm>
#include <memory>
#include <optional>
#include <string>

#include "bindings.hpp"
#include "session/session.hpp"
#include "stream/given.hpp"
#include "stream/image_arrays.hpp"

namespace {

using namespace lidarcodec;

// Fields of a lidarcodec.message.Message. Sections are parts of its bytes, which it keeps.
Message message_of(const nb::object& given) {
  const auto number = [&](const char* name) { return nb::cast<std::uint64_t>(given.attr(name)); };
  Message message;
  message.codec = static_cast<Codec>(number("codec"));
  message.key = nb::cast<bool>(given.attr("key"));
  message.planes = nb::cast<bool>(given.attr("planes"));
  message.goes_on = nb::cast<bool>(given.attr("goes_on"));
  message.stream_id = number("stream_id");
  message.frame_index = number("frame_index");
  message.stamp_ns = nb::cast<std::int64_t>(given.attr("stamp_ns"));
  message.needs = nb::cast<std::optional<std::uint64_t>>(given.attr("needs"));
  message.frame_count = number("frame_count");
  message.width = number("width");
  message.packets = number("packets");
  for (const nb::handle each : nb::cast<nb::tuple>(given.attr("sections"))) {
    const auto section = nb::cast<nb::tuple>(each);
    message.sections.push_back({nb::cast<std::uint8_t>(section[0]), nb::cast<std::uint8_t>(section[2]),
                                bytes_of(nb::cast<nb::bytes>(section[1]))});
  }
  return message;
}

using Described = Tuple<nb::str, nb::int_, nb::int_, nb::bytes>;
using Decoded = Tuple<Array<std::uint16_t>, Array<std::uint8_t>, Array<std::uint16_t>, Array<std::uint8_t>,
                      Array<std::uint8_t>, std::optional<Array<double>>, Described>;

Described described(const Sensor& sensor) {
  return Described(nb::make_tuple(nb::str(sensor.name.data(), sensor.name.size()), sensor.convention, sensor.range_step,
                                  nb::bytes(sensor.table.data(), sizeof sensor.table)));
}

nb::object give_pose(const std::optional<std::array<double, 12>>& pose) {
  return pose ? nb::cast(give(std::vector<double>(pose->begin(), pose->end()), {3, 4})) : nb::none();
}

Decoded decode(Session& session, const nb::object& given) {
  const Message message = message_of(given);
  SessionFrame frame;
  {
    nb::gil_scoped_release release;
    frame = session.decode(message);
  }
  Planes& planes = frame.planes;
  const std::size_t width = planes.width;
  return Decoded(
      nb::make_tuple(give(std::move(planes.range), {kRows, width}), give(std::move(planes.intensity), {kRows, width}),
                     give(std::move(planes.azimuth), {2, width}), give(std::move(planes.fired), {2, width}),
                     give(std::move(planes.returns), {kRows, width}), give_pose(frame.pose), described(*frame.sensor)));
}

// name, convention, range step, rows, model, description, table
using DescribedImages = Tuple<nb::str, nb::int_, nb::int_, nb::int_, nb::str, nb::bytes, nb::bytes>;
using DecodedImages = Tuple<DescribedImages, NamedNumbers, Rest, Fixed<std::uint16_t>,
                            std::optional<Fixed<std::uint16_t>>, std::optional<Array<double>>>;

DescribedImages described(const DescribedSensor& sensor) {
  const std::vector<std::int32_t>& table = sensor.table.values;
  return DescribedImages(nb::make_tuple(sensor.name, sensor.convention, sensor.range_step, sensor.rows(), sensor.model,
                                        give_bytes(sensor.description),
                                        nb::bytes(table.data(), table.size() * sizeof(std::int32_t))));
}

DecodedImages decode_images(Session& session, const nb::object& given) {
  const Message message = message_of(given);
  SessionFrame frame;
  std::vector<std::pair<std::string, Narrow>> planes;
  NarrowRest rest;
  {
    nb::gil_scoped_release release;
    frame = session.decode(message);
    if (!frame.images) throw Error(ErrorCode::Section, "a message of an HDL-64E, not of another sensor");
    planes = narrow_planes(std::move(frame.images->planes));
    rest = narrow_rest(std::move(frame.images->rest));
  }
  ImageFrame& images = *frame.images;
  nb::object lattice = nb::none();
  if (!images.lattice.empty()) {
    std::vector<std::uint16_t> columns(images.lattice.begin(), images.lattice.end());
    const std::size_t count = columns.size();
    lattice = nb::cast(give_fixed(std::move(columns), {count}));
  }
  const std::size_t width = images.azimuth.size();
  return DecodedImages(nb::make_tuple(described(*images.sensor), give_named(std::move(planes), images.sensor->rows()),
                                      give_rest(std::move(rest)), give_fixed(std::move(images.azimuth), {width}),
                                      lattice, give_pose(frame.pose)));
}

NamedNumbers decode_planes_section(const nb::bytes& section, std::size_t columns, Unzstd unzstd) {
  const GivenUnzstd outside(std::move(unzstd));
  std::vector<std::pair<std::string, Narrow>> planes;
  std::size_t rows = 0;
  {
    nb::gil_scoped_release release;
    PlaneSection found = decode_plane_section(bytes_of(section), columns, outside, nullptr);
    rows = found.rows;
    planes = narrow_planes(std::move(found.planes));
  }
  return give_named(std::move(planes), rows);
}

Rest decode_rest_section(const nb::bytes& section, std::size_t packets, Unzstd unzstd) {
  const GivenUnzstd outside(std::move(unzstd));
  NarrowRest rest;
  {
    nb::gil_scoped_release release;
    rest = narrow_rest(decode_rest(bytes_of(section), packets, outside));
  }
  return give_rest(std::move(rest));
}

}  // namespace

void bind_session(nb::module_& m) {
  nb::class_<Session>(m, "Session",
                      "Decoder of one stream: native/src/session. Not for two threads at once; waits for nothing.")
      .def(
          "__init__",
          [](Session* self, Unzstd unzstd, Inflate inflate, FindWeights weights, bool reads_ranges,
             std::optional<TakesModel> takes_model) {
            new (self) Session(std::make_unique<Given>(std::move(unzstd), std::move(inflate), std::move(weights),
                                                       reads_ranges, std::move(takes_model)));
          },
          nb::arg("unzstd"), nb::arg("inflate"), nb::arg("weights"), nb::arg("reads_ranges"),
          nb::arg("takes_model") = nb::none(),
          "unzstd: (frame, size) -> the bytes of one zstd frame; inflate: (stream, most) -> the bytes of one zlib "
          "stream, or None if it is damaged or holds more; weights: name -> weight file, or None; reads_ranges: the "
          "caller reads the ranges by itself; takes_model: whether the caller takes frames of a model of sensor that "
          "`knows_model` does not know.")
      .def("decode", &decode, nb::arg("message"),
           "Planes of a `Message` of one frame of an HDL-64E, W columns: range (64, W), zeros where the caller reads "
           "ranges; intensity (64, W), azimuth (2, W), fired (2, W), returns (64, W), pose (3, 4) or None, and the "
           "sensor: name, convention, range step in 1e-7 m, table (11, 64) int32 in the machine's byte order. Raises "
           "DecodeError.")
      .def("decode_images", &decode_images, nb::arg("message"),
           "A `Message` of one frame of another sensor, H rows and W columns, all arrays read-only: the sensor (name, "
           "convention, range step in 1e-7 m, H, model, description, table (11, H) int32 in the machine's byte order); "
           "names and images of its planes, (H, W) uint8, uint16 or uint32; its rest as of `decode_rest`; azimuth (W,) "
           "uint16; the columns that were sent, (K,) uint16, or None for all; pose (3, 4) or None. Of a point cloud "
           "the sensor, rest and pose alone. Of a model that `knows_model` does not know, layout and series are not "
           "checked, and azimuth is 0. Raises DecodeError.")
      .def("cut", &Session::cut, "Refuse messages that need another until one that needs none is decoded.");
  m.def(
      "knows_model", [](std::string_view model) { return is_known_model(model); }, nb::arg("model"),
      "Whether the core has the layouts and directions of a model of sensor beside the HDL-64E.");
  m.def("decode_plane_section", &decode_planes_section, nb::arg("data"), nb::arg("columns"), nb::arg("unzstd"),
        "Names and images of the planes of a PLANES section that begins a stream, (H, `columns`) uint8, uint16 or "
        "uint32 each. Raises DecodeError.");
  m.def("decode_rest", &decode_rest_section, nb::arg("data"), nb::arg("packets"), nb::arg("unzstd"),
        "A REST section of P packets: layout; packet_ns (P,) int64; odd (K,) uint16, the odd packets; names and "
        "numbers of the series, uint8, uint16, uint32 or uint64. Raises DecodeError.");
}
