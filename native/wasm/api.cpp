// What a page calls. Addresses are into the module's memory, and hold until the next call.
// Whoever calls writes bytes to where `lidarcodec_input` says, and names parts of them by where they begin and their size.
#include <cstddef>
#include <cstdint>
#include <vector>

#include "decoder.hpp"
#include "base/error.hpp"

#define EXPORT(name) extern "C" __attribute__((export_name(#name)))

using lidarcodec::wasm::Bytes;
using lidarcodec::wasm::Decoder;

namespace {

// Of one stream; a module has one.
struct Stream {
  std::vector<std::uint8_t> input;
  Decoder decoder;

  Bytes part(std::uint32_t at, std::uint32_t size) const {
    if (at > input.size() || size > input.size() - at)
      throw lidarcodec::Error(lidarcodec::ErrorCode::Section, "a part of the message beyond its end");
    return {input.data() + at, size};
  }
};

constexpr std::uint32_t kNone = 0xFFFFFFFF;

}  // namespace

EXPORT(lidarcodec_open) Stream* lidarcodec_open() { return new Stream; }
EXPORT(lidarcodec_close) void lidarcodec_close(Stream* stream) { delete stream; }

// Where to write `size` bytes.
EXPORT(lidarcodec_input) std::uint8_t* lidarcodec_input(Stream* stream, std::uint32_t size) {
  if (size > lidarcodec::wasm::kMostBytes) throw lidarcodec::Error(lidarcodec::ErrorCode::Header, "a message of more than 64 MiB");
  stream->input.resize(size);
  return stream->input.data();
}

// The input is (6, 64) i32: see Decoder::sensor.
EXPORT(lidarcodec_sensor) void lidarcodec_sensor(Stream* stream) {
  const Bytes rows = stream->part(0, 6 * lidarcodec::kRows * sizeof(std::int32_t));
  stream->decoder.sensor(reinterpret_cast<const std::int32_t*>(rows.data));
}

EXPORT(lidarcodec_columns) void lidarcodec_columns(Stream* stream, std::uint32_t at, std::uint32_t size, std::uint32_t width) {
  stream->decoder.columns(stream->part(at, size), width);
}

// motion_at: 0xFFFFFFFF where there is no MOTION section.
EXPORT(lidarcodec_mask) void lidarcodec_mask(Stream* stream, std::uint32_t at, std::uint32_t size, std::uint32_t keep, std::uint32_t motion_at,
                     std::uint32_t motion_size, std::uint32_t follows) {
  const Bytes motion = motion_at == kNone ? Bytes{} : stream->part(motion_at, motion_size);
  stream->decoder.mask(stream->part(at, size), keep != 0, motion, follows != 0);
}

EXPORT(lidarcodec_intensity) void lidarcodec_intensity(Stream* stream, std::uint32_t at, std::uint32_t size) {
  stream->decoder.intensity(stream->part(at, size));
}

// Networks of a weight file: forget those there are, add one, and code with them from now on, or without.
EXPORT(lidarcodec_begin_nets) void lidarcodec_begin_nets(Stream* stream) { stream->decoder.begin_nets(); }

EXPORT(lidarcodec_net) void lidarcodec_net(Stream* stream, std::uint32_t at, std::uint32_t size, std::uint32_t first, std::uint32_t second,
                    std::uint32_t shift1, std::uint32_t shift2, std::uint32_t shift3, std::uint32_t expects) {
  stream->decoder.net(stream->part(at, size), first, second, {shift1, shift2, shift3}, expects != 0);
}

EXPORT(lidarcodec_use_nets) void lidarcodec_use_nets(Stream* stream, std::uint32_t learned) { stream->decoder.use_nets(learned != 0); }

EXPORT(lidarcodec_ranges) void lidarcodec_ranges(Stream* stream, std::uint32_t at, std::uint32_t size, std::uint32_t step, std::uint32_t follows) {
  stream->decoder.ranges(stream->part(at, size), step, follows != 0);
}

EXPORT(lidarcodec_done) void lidarcodec_done(Stream* stream, std::uint32_t follows) { stream->decoder.done(follows != 0); }

// Arrays of the frame: azimuth (2, W) u16, fired (2, W) u8, returns, intensity (64, W) u8, range (64, W) u16.
EXPORT(lidarcodec_azimuth) const std::uint16_t* lidarcodec_azimuth(const Stream* stream) { return stream->decoder.azimuth.data(); }
EXPORT(lidarcodec_fired) const std::uint8_t* lidarcodec_fired(const Stream* stream) { return stream->decoder.fired.data(); }
EXPORT(lidarcodec_returns) const std::uint8_t* lidarcodec_returns(const Stream* stream) { return stream->decoder.returns.data(); }
EXPORT(lidarcodec_bright) const std::uint8_t* lidarcodec_bright(const Stream* stream) { return stream->decoder.bright.data(); }
EXPORT(lidarcodec_range) const std::uint16_t* lidarcodec_range(const Stream* stream) { return stream->decoder.range.data(); }
