// What a page calls: a session (native/src/session) with what the page gives it. Addresses are into the module's
// memory, and hold until the next call. The caller writes bytes to where `lidarcodec_input` says; the next call reads
// all of them.
//
// Nothing is caught. An error ends the call in the host (errors.cpp), which throws the whole module away.
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <map>
#include <string>
#include <vector>

#include "session/frames/ring_geometry.hpp"
#include "session/session.hpp"

#define EXPORT(name) extern "C" __attribute__((export_name(#name)))
#define IMPORT(name) extern "C" __attribute__((import_module("lidarcodec"), import_name(#name)))

using lidarcodec::Bytes;
using lidarcodec::Codec;

// Of the page: decompresses into `plain`. unzstd: 1, or 0 for a frame that is damaged or of another size; inflate: how
// many bytes it gave, or -1.
IMPORT(unzstd)
std::int32_t host_unzstd(const std::uint8_t* frame, std::uint32_t size, std::uint8_t* plain, std::uint32_t bytes);
IMPORT(inflate)
std::int32_t host_inflate(const std::uint8_t* stream, std::uint32_t size, std::uint8_t* plain, std::uint32_t most);

namespace {

class Page final : public lidarcodec::Outside {
 public:
  bool unzstd(Bytes frame, std::span<std::uint8_t> plain) const override {
    return host_unzstd(frame.data(), frame.size(), plain.data(), plain.size()) == 1;
  }
  std::optional<std::vector<std::uint8_t>> inflated(Bytes stream, std::size_t most) const override {
    std::vector<std::uint8_t> plain(most);
    const std::int32_t found = host_inflate(stream.data(), stream.size(), plain.data(), most);
    if (found < 0) return std::nullopt;
    plain.resize(static_cast<std::size_t>(found));
    return plain;
  }
  // The page reads its section, by `lidarcodec_read_planes` (clients/typescript/src/clouds).
  std::shared_ptr<const lidarcodec::DecodedCloud> cloud(Bytes) const override {
    throw lidarcodec::Error(lidarcodec::ErrorCode::Version, "point clouds are not decoded here");
  }
  // The page's own inflate answers later, so it opens a picture before its message is pushed.
  bool opens_pictures(Codec codec) const override { return codec == Codec::Png; }
  std::optional<std::vector<std::uint16_t>> picture(const lidarcodec::Picture&) const override { return samples; }
  std::optional<std::vector<std::uint8_t>> weights(const std::string& name) const override {
    const auto found = given.find(name);
    return found == given.end() ? std::nullopt : std::optional(found->second);
  }

  std::optional<std::vector<std::uint16_t>> samples;
  std::map<std::string, std::vector<std::uint8_t>> given;
};

// A frame of another sensor than an HDL-64E as a viewer takes it: ranges in 16 bits, intensities in 8, both halves of
// columns in one direction.
struct Shown {
  std::vector<std::uint16_t> range, azimuth;
  std::vector<std::uint8_t> intensity;
  std::vector<lidarcodec::RingGeometry> rings;
};

// Of one stream; a module has one.
struct Stream {
  std::vector<std::uint8_t> input;
  Page* page = new Page;
  lidarcodec::Session session{std::unique_ptr<const lidarcodec::Outside>(page)};
  const lidarcodec::SessionFrame* frame = nullptr;
  Shown shown;
  lidarcodec::PlaneSection planes;
  std::string missing;

  const lidarcodec::ImageFrame* images() const { return frame->images ? &*frame->images : nullptr; }
};

}  // namespace

EXPORT(lidarcodec_open) Stream* lidarcodec_open() { return new Stream; }

// Where to write `size` bytes.
EXPORT(lidarcodec_input) std::uint8_t* lidarcodec_input(Stream* stream, std::uint32_t size) {
  if (size > lidarcodec::kMostMessage)
    throw lidarcodec::Error(lidarcodec::ErrorCode::Header, "a message of more than 64 MiB");
  stream->input.resize(size);
  return stream->input.data();
}

// The input is a CALIBRATION section that an earlier message of the stream brought.
EXPORT(lidarcodec_give_calibration) void lidarcodec_give_calibration(Stream* stream) {
  stream->session.give_calibration(stream->input);
}

// The input is a message. Gives the name of weights that it needs and that are not here yet, which ends with a zero;
// "": none.
EXPORT(lidarcodec_missing_weights) const char* lidarcodec_missing_weights(Stream* stream) {
  stream->missing = stream->session.missing_weights(stream->input);
  return stream->missing.c_str();
}

// The input is the weight file of the name that was missing.
EXPORT(lidarcodec_give_weights) void lidarcodec_give_weights(Stream* stream) {
  stream->page->given[stream->missing] = stream->input;
}

// The input is the samples, u16, of the picture in the message that is pushed next.
EXPORT(lidarcodec_give_picture) void lidarcodec_give_picture(Stream* stream) {
  std::vector<std::uint16_t>& samples = stream->page->samples.emplace(stream->input.size() / 2);
  std::memcpy(samples.data(), stream->input.data(), 2 * samples.size());
}

// The input is a message, which is decoded.
EXPORT(lidarcodec_push) void lidarcodec_push(Stream* stream) {
  stream->frame = &stream->session.push(stream->input);
  stream->page->samples.reset();
  stream->shown = {};
  if (const lidarcodec::ImageFrame* const images = stream->images()) {
    stream->shown.range = lidarcodec::shown_ranges(*images);
    stream->shown.intensity = lidarcodec::shown_intensities(*images);
    stream->shown.azimuth = images->azimuth;
    stream->shown.azimuth.insert(stream->shown.azimuth.end(), images->azimuth.begin(), images->azimuth.end());
  }
}

// The input is a PLANES section of so many columns, as a CLOUD section has one: its rows, how many planes it has, and
// the name, which ends with a zero, and the numbers, (H, W) u32, of each.
EXPORT(lidarcodec_read_planes) void lidarcodec_read_planes(Stream* stream, std::uint32_t columns) {
  stream->planes = lidarcodec::decode_plane_section(stream->input, columns, *stream->page, nullptr);
}
EXPORT(lidarcodec_plane_rows) std::uint32_t lidarcodec_plane_rows(const Stream* stream) { return stream->planes.rows; }
EXPORT(lidarcodec_plane_count) std::uint32_t lidarcodec_plane_count(const Stream* stream) {
  return stream->planes.planes.size();
}
EXPORT(lidarcodec_plane_name) const char* lidarcodec_plane_name(const Stream* stream, std::uint32_t number) {
  return stream->planes.planes[number].name.c_str();
}
EXPORT(lidarcodec_plane_values)
const std::uint32_t* lidarcodec_plane_values(const Stream* stream, std::uint32_t number) {
  return stream->planes.planes[number].values.data();
}

// The frame that was pushed: H rows, W columns; azimuth (2, W) u16, range (H, W) u16, intensity (H, W) u8, or 0 where
// none are sent.
EXPORT(lidarcodec_rows) std::uint32_t lidarcodec_rows(const Stream* stream) {
  return stream->images() ? stream->images()->sensor->rows() : lidarcodec::kRows;
}
EXPORT(lidarcodec_width) std::uint32_t lidarcodec_width(const Stream* stream) {
  return stream->images() ? stream->images()->width : stream->frame->planes.width;
}
EXPORT(lidarcodec_azimuth) const std::uint16_t* lidarcodec_azimuth(const Stream* stream) {
  return stream->images() ? stream->shown.azimuth.data() : stream->frame->planes.azimuth.data();
}
// Of a frame without images there is none.
EXPORT(lidarcodec_range) const std::uint16_t* lidarcodec_range(const Stream* stream) {
  return stream->images() ? stream->shown.range.data() : stream->frame->planes.range.data();
}
EXPORT(lidarcodec_intensity) const std::uint8_t* lidarcodec_intensity(const Stream* stream) {
  if (!stream->frame->has_intensity) return nullptr;
  return stream->images() ? stream->shown.intensity.data() : stream->frame->planes.intensity.data();
}

// Its sensor: model, name and hash, which end with a zero; 0 `ros` or 1 `veloview`; range step, 1e-7 m; laser of each
// row, u8; of an HDL-64E the table (11, 64) i32.
EXPORT(lidarcodec_sensor_model) const char* lidarcodec_sensor_model(const Stream* stream) {
  return stream->images() ? stream->images()->sensor->model.c_str() : "hdl64e";
}
EXPORT(lidarcodec_sensor_name) const char* lidarcodec_sensor_name(const Stream* stream) {
  return (stream->images() ? stream->images()->sensor->name : stream->frame->sensor->name).c_str();
}
EXPORT(lidarcodec_sensor_hash) const char* lidarcodec_sensor_hash(const Stream* stream) {
  return (stream->images() ? stream->images()->sensor->hash : stream->frame->sensor->hash).c_str();
}
EXPORT(lidarcodec_convention) std::uint32_t lidarcodec_convention(const Stream* stream) {
  return stream->images() ? stream->images()->sensor->convention : stream->frame->sensor->convention;
}
EXPORT(lidarcodec_range_step) double lidarcodec_range_step(const Stream* stream) {
  if (const lidarcodec::ImageFrame* const images = stream->images())
    return static_cast<double>(images->sensor->range_step) * lidarcodec::shown_step(*images);
  return stream->frame->sensor->range_step;
}
EXPORT(lidarcodec_laser) const std::uint8_t* lidarcodec_laser(const Stream* stream) {
  return stream->images() ? stream->images()->sensor->laser.data() : stream->frame->sensor->laser.data();
}
EXPORT(lidarcodec_table) const std::int32_t* lidarcodec_table(const Stream* stream) {
  return stream->frame->sensor->table.data();
}
// (H, 5) f64 of another sensor, fitted to the frame: rotation, elevation, distance, height, aside; 0 of an HDL-64E.
EXPORT(lidarcodec_rings) const lidarcodec::RingGeometry* lidarcodec_rings(Stream* stream) {
  if (!stream->images()) return nullptr;
  stream->shown.rings = lidarcodec::ring_geometry(*stream->images());
  return stream->shown.rings.data();
}
