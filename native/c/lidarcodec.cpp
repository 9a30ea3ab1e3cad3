// The C interface (native/include/lidarcodec.h): a session with the system's zstd and zlib. No exception leaves it.
#include "lidarcodec.h"

#include <zlib.h>
#include <zstd.h>

#include <algorithm>
#include <cstring>
#include <exception>
#include <map>
#include <new>
#include <string>

#include "png.hpp"
#include "session/frames/cloud_points.hpp"
#include "session/pictures/picture_session.hpp"
#include "session/points.hpp"

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

  std::shared_ptr<const lidarcodec::DecodedCloud> cloud(Bytes section) const override {
    return std::make_shared<const lidarcodec::DecodedCloud>(lidarcodec::decode_cloud(section, *this));
  }

  bool opens_pictures(lidarcodec::Codec codec) const override {
    return codec == lidarcodec::Codec::Png || openers_.count(codec) != 0;
  }

  // Of the codecs that PictureSession reads.
  bool reads_ranges(lidarcodec::Codec codec, bool planes) const override {
    const bool is_exact = codec == lidarcodec::Codec::Png || (codec == lidarcodec::Codec::Jxl && planes);
    return !is_exact && openers_.count(codec) != 0;
  }

  std::optional<std::vector<std::uint16_t>> picture(const lidarcodec::Picture& picture) const override {
    const auto opener = openers_.find(picture.codec);
    if (opener == openers_.end()) return lidarcodec::png_samples(picture, *this);
    const auto [open, context] = opener->second;
    std::vector<std::uint16_t> samples(picture.rows * picture.width);
    const lidarcodec_picture asked = {picture.data.data(),
                                      picture.data.size(),
                                      static_cast<std::uint32_t>(picture.rows),
                                      static_cast<std::uint32_t>(picture.width),
                                      static_cast<std::uint16_t>(picture.codec),
                                      static_cast<std::uint8_t>(picture.bits),
                                      picture.begins};
    return open(context, &asked, samples.data()) != 0 ? std::optional(std::move(samples)) : std::nullopt;
  }

  std::optional<std::vector<std::uint8_t>> weights(const std::string& name) const override {
    const auto found = weights_.find(name);
    return found == weights_.end() ? std::nullopt : std::optional(found->second);
  }

  void give(std::vector<std::uint8_t> data) { weights_[lidarcodec::read_weights(data).name] = std::move(data); }

  void give(lidarcodec::Codec codec, lidarcodec_open_picture open, void* context) {
    if (codec < lidarcodec::Codec::Png || codec > lidarcodec::Codec::H264Log)
      throw lidarcodec::Error(ErrorCode::Version,
                              "there is no codec " + std::to_string(static_cast<unsigned>(codec)) + " of pictures");
    openers_.erase(codec);
    if (open != nullptr) openers_[codec] = {open, context};
  }

 private:
  std::map<lidarcodec::Codec, std::pair<lidarcodec_open_picture, void*>> openers_;
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

// A frame as the interface shows it.
struct Shown {
  std::vector<lidarcodec_plane> planes;
  std::vector<std::uint16_t> azimuth;
  std::vector<std::uint8_t> fired;
  std::optional<lidarcodec::CloudPoints> cloud;  // of a point cloud
};

constexpr lidarcodec_plane plane(const char* name, const void* values, std::size_t bytes, std::uint32_t bits,
                                 lidarcodec::PlaneRole role, std::size_t of) {
  return {name,
          values,
          static_cast<std::uint8_t>(bytes),
          static_cast<std::uint8_t>(bits),
          static_cast<std::uint8_t>(role),
          static_cast<std::uint8_t>(of)};
}

template <class Number>
std::uint32_t returns_in(const std::vector<Number>& ranges) {
  return static_cast<std::uint32_t>(
      std::count_if(ranges.begin(), ranges.end(), [](Number range) { return range != 0; }));
}

// Fields of a frame of an HDL-64E.
void show(const lidarcodec::Planes& planes, const lidarcodec::Sensor& sensor, Shown& shown, lidarcodec_frame& frame) {
  using lidarcodec::PlaneRole;
  shown.planes = {plane("range", planes.range.data(), 2, 16, PlaneRole::Range, 0),
                  plane("intensity", planes.intensity.data(), 1, 8, PlaneRole::Attribute, 0)};
  frame.rows = lidarcodec::kRows;
  frame.width = static_cast<std::uint32_t>(planes.width);
  frame.points = returns_in(planes.range);
  frame.range_step_m = sensor.range_step * 1e-7;
  frame.azimuth = planes.azimuth.data();
  frame.fired = planes.fired.data();
  frame.laser = sensor.laser.data();
  frame.sensor = sensor.name.c_str();
  frame.model = "hdl64e";
}

// The same of another sensor.
void show(const lidarcodec::ImageFrame& images, Shown& shown, lidarcodec_frame& frame) {
  const lidarcodec::DescribedSensor& sensor = *images.sensor;
  shown.planes.clear();
  if (images.cloud) shown.cloud = lidarcodec::CloudPoints::of(images.cloud->payload);
  for (const lidarcodec::NamedPlane& one : images.planes)
    shown.planes.push_back(plane(one.name.c_str(), one.values.data(), 4, one.bits, one.role, one.of));
  shown.azimuth = images.azimuth;
  shown.azimuth.insert(shown.azimuth.end(), images.azimuth.begin(), images.azimuth.end());
  shown.fired.assign(shown.azimuth.size(), 1);
  frame.rows = static_cast<std::uint32_t>(sensor.rows());
  frame.width = static_cast<std::uint32_t>(images.width);
  frame.points = images.planes.empty() ? 0 : returns_in(images.planes[0].values);
  if (shown.cloud) frame.points = static_cast<std::uint32_t>(lidarcodec::returns_of_cloud(*shown.cloud));
  frame.range_step_m = sensor.range_step * 1e-7;
  frame.azimuth = shown.azimuth.data();
  frame.fired = shown.fired.data();
  frame.laser = sensor.laser.data();
  frame.sensor = sensor.name.c_str();
  frame.model = sensor.model.c_str();
}

}  // namespace

struct lidarcodec_session {
  System* outside = new System;
  lidarcodec::PictureSession session{std::unique_ptr<const lidarcodec::Outside>(outside)};
  const std::vector<lidarcodec::SessionFrame>* frames = nullptr;  // of the message that was pushed last
  std::size_t number = 0;                                         // of the frame that is shown
  const lidarcodec::SessionFrame* frame = nullptr;
  Shown shown;
  std::string text;
  std::uint64_t offset = 0, needs = 0;

  // The frame of a number of the message that was pushed last, for all functions to be about.
  lidarcodec_frame show_frame(std::size_t which) {
    const lidarcodec::SessionFrame& found = (*frames)[which];
    lidarcodec_frame given{};
    if (found.images)
      show(*found.images, shown, given);
    else
      show(found.planes, *found.sensor, shown, given);
    frame = &found;
    number = which;
    given.stream_id = found.stream_id;
    given.index = found.index;
    given.stamp_ns = found.stamp_ns;
    given.codec = static_cast<std::uint16_t>(found.codec);
    given.key = found.key;
    given.has_intensity = shown.cloud ? lidarcodec::intensity_field(*shown.cloud) != nullptr : found.has_intensity;
    given.plane_count = static_cast<std::uint32_t>(shown.planes.size());
    given.planes = shown.planes.data();
    given.pose = found.pose ? found.pose->data() : nullptr;
    return given;
  }

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

lidarcodec_status lidarcodec_give_pictures(lidarcodec_session* session, uint16_t codec, lidarcodec_open_picture open,
                                           void* context) {
  return session->guarded([&] { session->outside->give(static_cast<lidarcodec::Codec>(codec), open, context); });
}

lidarcodec_status lidarcodec_push(lidarcodec_session* session, const uint8_t* message, size_t size,
                                  lidarcodec_frame* frame) {
  session->frames = nullptr;
  session->frame = nullptr;
  session->shown.cloud.reset();
  return session->guarded([&] {
    session->frames = &session->session.push({message, size});
    const lidarcodec_frame given = session->show_frame(0);
    if (frame != nullptr) *frame = given;
  });
}

int lidarcodec_next(lidarcodec_session* session, lidarcodec_frame* frame) {
  if (session->frame == nullptr || session->number + 1 == session->frames->size()) return 0;
  return session->guarded([&] {
    const lidarcodec_frame given = session->show_frame(session->number + 1);
    if (frame != nullptr) *frame = given;
  }) == LIDARCODEC_OK;
}

size_t lidarcodec_points(const lidarcodec_session* session, lidarcodec_returns returns, lidarcodec_point* points,
                         size_t capacity) {
  if (session->frame == nullptr) return 0;
  try {
    const std::vector<lidarcodec::CloudPoint> found = lidarcodec::points_of(*session->frame, returns == LIDARCODEC_ALL);
    for (std::size_t i = 0; i < std::min(capacity, found.size()); ++i) {
      const lidarcodec::CloudPoint& one = found[i];
      points[i] = {one.x, one.y, one.z, one.intensity, one.cell, one.laser, one.ring, one.return_number, 0, one.t_ns};
    }
    return found.size();
  } catch (...) {
    return 0;
  }
}

size_t lidarcodec_fields(const lidarcodec_session* session, lidarcodec_field* fields, size_t capacity) {
  if (session->frame == nullptr || !session->shown.cloud) return 0;
  const std::vector<lidarcodec::CloudField>& found = session->shown.cloud->head().fields;
  for (std::size_t i = 0; i < std::min(capacity, found.size()); ++i)
    fields[i] = {found[i].name.c_str(), found[i].repeated, static_cast<std::uint8_t>(found[i].type),
                 static_cast<std::uint8_t>(lidarcodec::bytes_of(found[i].type))};
  return found.size();
}

size_t lidarcodec_values(const lidarcodec_session* session, size_t field, void* values, size_t capacity) {
  if (session->frame == nullptr || !session->shown.cloud) return 0;
  const lidarcodec::CloudPoints& cloud = *session->shown.cloud;
  if (field >= cloud.head().fields.size()) return 0;
  const lidarcodec::CloudField& found = cloud.head().fields[field];
  const std::size_t there = cloud.size() * found.repeated;
  auto* const to = static_cast<std::uint8_t*>(values);
  const auto put = [&]<class Number>(Number) {
    for (std::size_t i = 0; i < std::min(capacity, there); ++i) {
      const auto value = static_cast<Number>(cloud.bits(found, i / found.repeated, i % found.repeated));
      std::memcpy(to + i * sizeof(Number), &value, sizeof(Number));
    }
  };
  switch (lidarcodec::bytes_of(found.type)) {
    case 1:
      put(std::uint8_t{});
      break;
    case 2:
      put(std::uint16_t{});
      break;
    case 4:
      put(std::uint32_t{});
      break;
    default:
      put(std::uint64_t{});
  }
  return there;
}

const uint8_t* lidarcodec_message(const lidarcodec_session* session, size_t* size) {
  const lidarcodec::SessionFrame* const frame = session->frame;
  const bool there = frame != nullptr && frame->images && frame->images->cloud;
  *size = there ? frame->images->cloud->payload.size() : 0;
  return there ? frame->images->cloud->payload.data() : nullptr;
}

const char* lidarcodec_error_text(const lidarcodec_session* session) { return session->text.c_str(); }
uint64_t lidarcodec_error_offset(const lidarcodec_session* session) { return session->offset; }
uint64_t lidarcodec_error_needs(const lidarcodec_session* session) { return session->needs; }
