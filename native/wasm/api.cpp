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
  // The page's own inflate answers later, so it opens a picture before its message is pushed.
  bool opens_pictures(Codec codec) const override { return codec == Codec::Png; }
  std::optional<std::vector<std::uint16_t>> picture(Codec, Bytes, std::size_t, std::size_t) const override {
    return samples;
  }
  std::optional<std::vector<std::uint8_t>> weights(const std::string& name) const override {
    const auto found = given.find(name);
    return found == given.end() ? std::nullopt : std::optional(found->second);
  }

  std::optional<std::vector<std::uint16_t>> samples;
  std::map<std::string, std::vector<std::uint8_t>> given;
};

// Of one stream; a module has one.
struct Stream {
  std::vector<std::uint8_t> input;
  Page* page = new Page;
  lidarcodec::Session session{std::unique_ptr<const lidarcodec::Outside>(page)};
  const lidarcodec::SessionFrame* frame = nullptr;
  std::string missing;
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
}

// The frame that was pushed: W columns; azimuth (2, W) u16, range (64, W) u16, intensity (64, W) u8, or 0 where none
// are sent.
EXPORT(lidarcodec_width) std::uint32_t lidarcodec_width(const Stream* stream) { return stream->frame->planes.width; }
EXPORT(lidarcodec_azimuth) const std::uint16_t* lidarcodec_azimuth(const Stream* stream) {
  return stream->frame->planes.azimuth.data();
}
EXPORT(lidarcodec_range) const std::uint16_t* lidarcodec_range(const Stream* stream) {
  return stream->frame->planes.range.data();
}
EXPORT(lidarcodec_intensity) const std::uint8_t* lidarcodec_intensity(const Stream* stream) {
  return stream->frame->has_intensity ? stream->frame->planes.intensity.data() : nullptr;
}

// Its sensor: name and hash, which end with a zero; 0 `ros` or 1 `veloview`; range step, 1e-7 m; table (11, 64) i32;
// laser of each row, u8.
EXPORT(lidarcodec_sensor_name) const char* lidarcodec_sensor_name(const Stream* stream) {
  return stream->frame->sensor->name.c_str();
}
EXPORT(lidarcodec_sensor_hash) const char* lidarcodec_sensor_hash(const Stream* stream) {
  return stream->frame->sensor->hash.c_str();
}
EXPORT(lidarcodec_convention) std::uint32_t lidarcodec_convention(const Stream* stream) {
  return stream->frame->sensor->convention;
}
EXPORT(lidarcodec_range_step) std::uint32_t lidarcodec_range_step(const Stream* stream) {
  return stream->frame->sensor->range_step;
}
EXPORT(lidarcodec_table) const std::int32_t* lidarcodec_table(const Stream* stream) {
  return stream->frame->sensor->table.data();
}
EXPORT(lidarcodec_laser) const std::uint8_t* lidarcodec_laser(const Stream* stream) {
  return stream->frame->sensor->laser.data();
}
