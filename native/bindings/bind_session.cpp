#include <nanobind/stl/optional.h>
#include <nanobind/stl/string.h>

#include <algorithm>
#include <memory>
#include <optional>
#include <string>

#include "bindings.hpp"
#include "session/session.hpp"

namespace {

using namespace lidarcodec;

using Unzstd = nb::typed<nb::callable, nb::bytes(nb::bytes, nb::int_)>;
using FindWeights = nb::typed<nb::callable, std::optional<nb::bytes>(nb::str)>;

Bytes bytes_of(const nb::bytes& data) { return {data_of(data), data.size()}; }

// What Python gives a session. The session runs without the interpreter's lock, each of these takes it.
class Given final : public Outside {
 public:
  Given(Unzstd unzstd, FindWeights weights, bool reads_ranges)
      : unzstd_(std::move(unzstd)), weights_(std::move(weights)), reads_ranges_(reads_ranges) {}

  bool unzstd(Bytes frame, std::span<std::uint8_t> plain) const override {
    nb::gil_scoped_acquire lock;
    const auto found = nb::cast<nb::bytes>(unzstd_(nb::bytes(frame.data(), frame.size()), plain.size()));
    if (found.size() != plain.size()) return false;
    std::copy_n(data_of(found), plain.size(), plain.begin());
    return true;
  }

  // Only lattices are: Python reads them by itself.
  std::optional<std::vector<std::uint8_t>> inflated(Bytes, std::size_t) const override { return std::nullopt; }

  bool reads_ranges(Codec) const override { return reads_ranges_; }

  std::optional<std::vector<std::uint8_t>> weights(const std::string& name) const override {
    nb::gil_scoped_acquire lock;
    const nb::object found = weights_(name);
    if (found.is_none()) return std::nullopt;
    const Bytes data = bytes_of(nb::cast<nb::bytes>(found));
    return std::vector<std::uint8_t>(data.begin(), data.end());
  }

 private:
  Unzstd unzstd_;
  FindWeights weights_;
  bool reads_ranges_;
};

// Fields of a lidarcodec.message.Message. Sections are parts of its bytes, which it keeps.
Message message_of(const nb::object& given) {
  const auto number = [&](const char* name) { return nb::cast<std::uint64_t>(given.attr(name)); };
  Message message;
  message.codec = static_cast<Codec>(number("codec"));
  message.key = nb::cast<bool>(given.attr("key"));
  message.planes = nb::cast<bool>(given.attr("planes"));
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

Decoded decode(Session& session, const nb::object& given) {
  const Message message = message_of(given);
  SessionFrame frame;
  {
    nb::gil_scoped_release release;
    frame = session.decode(message);
  }
  Planes& planes = frame.planes;
  const std::size_t width = planes.width;
  nb::object pose = nb::none();
  if (frame.pose) pose = nb::cast(give(std::vector<double>(frame.pose->begin(), frame.pose->end()), {3, 4}));
  return Decoded(nb::make_tuple(give(std::move(planes.range), {kRows, width}),
                                give(std::move(planes.intensity), {kRows, width}),
                                give(std::move(planes.azimuth), {2, width}), give(std::move(planes.fired), {2, width}),
                                give(std::move(planes.returns), {kRows, width}), pose, described(*frame.sensor)));
}

}  // namespace

void bind_session(nb::module_& m) {
  nb::class_<Session>(m, "Session",
                      "Decoder of one stream: native/src/session. Not for two threads at once; waits for nothing.")
      .def(
          "__init__",
          [](Session* self, Unzstd unzstd, FindWeights weights, bool reads_ranges) {
            new (self) Session(std::make_unique<Given>(std::move(unzstd), std::move(weights), reads_ranges));
          },
          nb::arg("unzstd"), nb::arg("weights"), nb::arg("reads_ranges"),
          "unzstd: (frame, size) -> the bytes of one zstd frame; weights: name -> weight file, or None; reads_ranges: "
          "the caller reads the ranges by itself.")
      .def("decode", &decode, nb::arg("message"),
           "Planes of a `Message` of one frame, W columns: range (64, W), zeros where the caller reads ranges; "
           "intensity (64, W), azimuth (2, W), fired (2, W), returns (64, W), pose (3, 4) or None, and the sensor: "
           "name, "
           "convention, range step in 1e-7 m, table (11, 64) int32 in the machine's byte order. Raises DecodeError.")
      .def("cut", &Session::cut, "Refuse messages that need another until one that needs none is decoded.");
}
