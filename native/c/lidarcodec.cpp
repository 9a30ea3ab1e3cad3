// The C interface (native/include/lidarcodec.h): a session with the system's zstd and zlib. No exception leaves it.
#include "lidarcodec.h"

#include <zlib.h>
#include <zstd.h>

#include <algorithm>
#include <exception>
#include <map>
#include <new>
#include <string>

#include "session/points.hpp"
#include "session/session.hpp"

namespace {

using lidarcodec::Bytes;
using lidarcodec::ErrorCode;

class System final : public lidarcodec::Outside {
 public:
  bool unzstd(Bytes frame, std::span<std::uint8_t> plain) const override {
    return ZSTD_decompress(plain.data(), plain.size(), frame.data(), frame.size()) == plain.size();
  }

  std::optional<std::vector<std::uint8_t>> inflated(Bytes stream, std::size_t most) const override {
    std::vector<std::uint8_t> plain(most + 1);  // a byte more, to see whether the stream has more
    z_stream inflater{};
    if (inflateInit(&inflater) != Z_OK) throw std::bad_alloc();
    inflater.next_in = const_cast<Bytef*>(stream.data());
    inflater.avail_in = static_cast<uInt>(stream.size());
    inflater.next_out = plain.data();
    inflater.avail_out = static_cast<uInt>(plain.size());
    const int end = inflate(&inflater, Z_FINISH);
    const std::size_t found = plain.size() - inflater.avail_out;
    const bool whole = end == Z_STREAM_END && inflater.avail_in == 0 && found <= most;
    inflateEnd(&inflater);
    if (!whole) return std::nullopt;
    plain.resize(found);
    return plain;
  }

  std::optional<std::vector<std::uint8_t>> weights(const std::string& name) const override {
    const auto found = weights_.find(name);
    return found == weights_.end() ? std::nullopt : std::optional(found->second);
  }

  void give(std::vector<std::uint8_t> data) { weights_[lidarcodec::read_weights(data).name] = std::move(data); }

 private:
  std::map<std::string, std::vector<std::uint8_t>> weights_;
};

lidarcodec_status status_of(ErrorCode code) {
  switch (code) {
    case ErrorCode::Header:
      return LIDARCODEC_BAD_HEADER;
    case ErrorCode::Version:
      return LIDARCODEC_UNSUPPORTED;
    case ErrorCode::Truncated:
      return LIDARCODEC_TRUNCATED;
    case ErrorCode::Checksum:
      return LIDARCODEC_BAD_CHECKSUM;
    case ErrorCode::Section:
      return LIDARCODEC_BAD_SECTION;
    case ErrorCode::Reference:
      return LIDARCODEC_MISSING_REFERENCE;
    default:
      return LIDARCODEC_FAILED;
  }
}

}  // namespace

struct lidarcodec_session {
  System* outside = new System;
  lidarcodec::Session session{std::unique_ptr<const lidarcodec::Outside>(outside)};
  const lidarcodec::SessionFrame* frame = nullptr;
  std::string text;
  std::uint64_t offset = 0, needs = 0;

  // Runs a part of a call; what it throws becomes a status, a sentence and numbers.
  template <class Work>
  lidarcodec_status guarded(const Work& work) noexcept {
    try {
      offset = needs = 0;
      work();
      return LIDARCODEC_OK;
    } catch (const lidarcodec::Error& error) {
      (error.code() == ErrorCode::Reference ? needs : offset) = error.offset();
      return failed(error.what(), status_of(error.code()));
    } catch (const std::bad_alloc&) {
      return failed("no memory", LIDARCODEC_OUT_OF_MEMORY);
    } catch (const std::exception& error) {
      return failed(error.what(), LIDARCODEC_FAILED);
    }
  }

 private:
  lidarcodec_status failed(const char* what, lidarcodec_status status) noexcept {
    try {
      text = what;
    } catch (const std::bad_alloc&) {
      text.clear();
    }
    return status;
  }
};

lidarcodec_session* lidarcodec_open(void) {
  try {
    return new lidarcodec_session;
  } catch (...) {
    return nullptr;
  }
}

void lidarcodec_close(lidarcodec_session* session) { delete session; }

lidarcodec_status lidarcodec_give_weights(lidarcodec_session* session, const uint8_t* data, size_t size) {
  return session->guarded([&] { session->outside->give({data, data + size}); });
}

lidarcodec_status lidarcodec_push(lidarcodec_session* session, const uint8_t* message, size_t size,
                                  lidarcodec_frame* frame) {
  session->frame = nullptr;
  return session->guarded([&] {
    const lidarcodec::SessionFrame& found = session->session.push({message, size});
    const lidarcodec::Planes& planes = found.planes;
    session->frame = &found;
    lidarcodec_frame given{};
    given.stream_id = found.stream_id;
    given.index = found.index;
    given.stamp_ns = found.stamp_ns;
    given.codec = static_cast<std::uint16_t>(found.codec);
    given.key = found.key;
    given.has_intensity = found.has_intensity;
    given.width = static_cast<std::uint32_t>(planes.width);
    given.points = static_cast<std::uint32_t>(
        std::count_if(planes.range.begin(), planes.range.end(), [](std::uint16_t range) { return range != 0; }));
    given.range_step_m = found.sensor->range_step * 1e-7;
    given.range = planes.range.data();
    given.intensity = planes.intensity.data();
    given.azimuth = planes.azimuth.data();
    given.fired = planes.fired.data();
    given.laser = found.sensor->laser.data();
    given.pose = found.pose ? found.pose->data() : nullptr;
    given.sensor = found.sensor->name.c_str();
    if (frame != nullptr) *frame = given;
  });
}

size_t lidarcodec_points(const lidarcodec_session* session, lidarcodec_point* points, size_t capacity) {
  if (session->frame == nullptr) return 0;
  try {
    const std::vector<lidarcodec::CloudPoint> found = lidarcodec::points_of(*session->frame);
    for (std::size_t i = 0; i < std::min(capacity, found.size()); ++i)
      points[i] = {found[i].x, found[i].y, found[i].z, found[i].intensity, found[i].laser, found[i].ring, 0};
    return found.size();
  } catch (...) {
    return 0;
  }
}

const char* lidarcodec_error_text(const lidarcodec_session* session) { return session->text.c_str(); }
uint64_t lidarcodec_error_offset(const lidarcodec_session* session) { return session->offset; }
uint64_t lidarcodec_error_needs(const lidarcodec_session* session) { return session->needs; }
