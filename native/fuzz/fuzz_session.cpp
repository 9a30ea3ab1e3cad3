// libFuzzer: streams of messages into one decoder session, by the C interface and by the C++ class. Sizes, checksums
// and names that a message carries are made right first, so that damage lies behind them. Needs the headers of zstd and
// zlib.
#include <cmath>

#include "../c/lidarcodec.cpp"
#include "parts/fuzz_messages.hpp"
#include "session/frames/ring_geometry.hpp"

namespace {

[[noreturn]] void broken() { std::abort(); }

void check_planes(const lidarcodec::Planes& planes) {
  const std::size_t cells = lidarcodec::kRows * planes.width;
  if (planes.width > lidarcodec::kMostColumns || planes.range.size() != cells || planes.intensity.size() != cells ||
      planes.returns.size() != cells || planes.azimuth.size() != 2 * planes.width ||
      planes.fired.size() != 2 * planes.width)
    broken();
  for (const std::uint16_t azimuth : planes.azimuth)
    if (azimuth >= 36'000) broken();
  for (const std::uint8_t fired : planes.fired)
    if (fired > 1) broken();
}

void check_images(const lidarcodec::ImageFrame& images) {
  const std::size_t cells = images.sensor->rows() * images.width;
  if (images.width > lidarcodec::kMostColumns || images.azimuth.size() != images.width) broken();
  for (const lidarcodec::NamedPlane& plane : images.planes) {
    if (plane.values.size() != cells || plane.of >= images.planes.size()) broken();
    for (const std::uint32_t value : plane.values)
      if (plane.role == lidarcodec::PlaneRole::Attribute ? value >> plane.bits != 0 : value >> 20 != 0) broken();
  }
  for (const std::uint16_t azimuth : images.azimuth)
    if (azimuth >= 36'000) broken();
  for (const lidarcodec::RingGeometry& ring : lidarcodec::ring_geometry(images))
    if (!std::isfinite(ring.rotation + ring.elevation + ring.aside)) broken();
  if (lidarcodec::shown_ranges(images).size() != (images.planes.empty() ? 0 : cells)) broken();
  lidarcodec::shown_intensities(images);
}

constexpr std::uint16_t kPng = 4, kJxl = 5, kH264 = 8, kH264Log = 9;
constexpr std::size_t kMostSamples = std::size_t{1} << 24, kLeastPicture = 4;

// A picture whose samples are its bytes, over and over; some cannot be opened, and a few have too many bits. context:
// whether a picture of a video was opened, to which the next may refer; or nothing
int open_anything(void* context, const lidarcodec_picture* picture, std::uint16_t* samples) {
  const std::size_t count = std::size_t{picture->rows} * picture->width;
  const bool is_exact = picture->codec <= kJxl, is_video = picture->codec == kH264 || picture->codec == kH264Log;
  if (count == 0 || count > kMostSamples || (picture->bits == 16) != is_exact || (is_video && picture->bits > 10) ||
      (!is_exact && picture->size < kLeastPicture) || (!is_video && picture->begins != 1))
    broken();
  const unsigned most = picture->size % 64 == 13 ? 16 : picture->bits;
  for (std::size_t i = 0; i < count; ++i)
    samples[i] =
        picture->size == 0
            ? 0
            : static_cast<std::uint16_t>((picture->data[i % picture->size] * 257u >> i % 9) & ((1u << most) - 1));
  const bool opened = picture->size % 16 != 15;
  if (is_video && context != nullptr) {
    auto& goes_on = *static_cast<bool*>(context);
    if (picture->begins == 0 && !goes_on) broken();
    goes_on = opened && most == picture->bits;
  }
  return opened;
}

// way: by the system's own decoder of PNG, or by that above
void decode_by_class(const std::vector<Bytes8>& messages, unsigned way) {
  auto system = std::make_unique<System>();
  system->give(lidarcodec::Codec::Jxl, open_anything, nullptr);
  if (way % 2 == 1) system->give(lidarcodec::Codec::Png, open_anything, nullptr);
  lidarcodec::Session session(std::move(system));
  MessageRepair repair;
  for (const Bytes8& given : messages) {
    const Bytes8 message = repair.repaired(given);
    session.missing_weights(message);
    try {
      if (repair.joins_late() && !repair.calibration().empty()) session.give_calibration(repair.calibration());
      const lidarcodec::SessionFrame& frame = session.push(message);
      repair.decoded(frame.index);
      if (frame.images)
        check_images(*frame.images);
      else
        check_planes(frame.planes);
      for (const lidarcodec::CloudPoint& point : lidarcodec::points_of(frame, true))
        if (!std::isfinite(point.x) || !std::isfinite(point.y) || !std::isfinite(point.z)) broken();
    } catch (const lidarcodec::Error&) {
    }
  }
}

// The message of a point cloud and all values of its fields, of the first one written into room for too few.
std::uint64_t read_cloud(const lidarcodec_session* session) {
  std::size_t size = 1;
  const std::uint8_t* const message = lidarcodec_message(session, &size);
  std::uint64_t sum = 0;
  if (message == nullptr && size != 0) broken();
  for (std::size_t i = 0; i < size; ++i) sum += message[i];
  std::vector<lidarcodec_field> fields(lidarcodec_fields(session, nullptr, 0));
  if (message == nullptr && !fields.empty()) broken();
  lidarcodec_fields(session, fields.data(), fields.size());
  for (std::size_t place = 0; place < fields.size(); ++place) {
    sum += std::char_traits<char>::length(fields[place].name);
    const std::size_t count = lidarcodec_values(session, place, nullptr, 0), room = count - (count > 0 && place == 0);
    std::vector<std::uint8_t> values(room * fields[place].bytes);
    if (lidarcodec_values(session, place, values.data(), room) != count) broken();
    for (const std::uint8_t value : values) sum += value;
  }
  if (lidarcodec_values(session, fields.size(), nullptr, 0) != 0) broken();
  return sum;
}

// Everything that a frame points to is read; its points are written into room for too few.
void check_frame(const lidarcodec_session* session, const lidarcodec_frame& frame) {
  std::uint64_t sum = std::char_traits<char>::length(frame.sensor) + std::char_traits<char>::length(frame.model);
  const bool is_hdl64e = std::string(frame.model) == "hdl64e";
  for (std::size_t number = 0; number < frame.plane_count; ++number) {
    const lidarcodec_plane& plane = frame.planes[number];
    sum += std::char_traits<char>::length(plane.name);
    const auto* const bytes = static_cast<const std::uint8_t*>(plane.values);
    for (std::size_t i = 0; i < std::size_t{frame.rows} * frame.width * plane.bytes; ++i) sum += bytes[i];
  }
  for (std::size_t i = 0; i < std::size_t{2} * frame.width; ++i) sum += frame.azimuth[i] + frame.fired[i];
  for (std::size_t row = 0; row < frame.rows; ++row)
    if (frame.laser[row] >= frame.rows) broken();
  for (std::size_t i = 0; frame.pose != nullptr && i < 12; ++i) sum += std::isfinite(frame.pose[i]);
  sum += read_cloud(session);
  [[maybe_unused]] volatile std::uint64_t kept = sum;
  std::vector<lidarcodec_point> points(frame.points / 2);
  const std::size_t there = lidarcodec_points(session, LIDARCODEC_FIRST, points.data(), points.size());
  if (is_hdl64e ? there != frame.points : there != 0 && there != frame.points) broken();
  if (lidarcodec_points(session, LIDARCODEC_ALL, points.data(), points.size()) < there) broken();
}

// Calls between messages that are of no use, in any order.
void call_anything(lidarcodec_session* session, unsigned which, const Bytes8& some) {
  lidarcodec_frame frame{};
  if (which & 1u) lidarcodec_points(session, LIDARCODEC_ALL, nullptr, 0);
  if (which & 2u && lidarcodec_push(session, nullptr, 0, &frame) != LIDARCODEC_TRUNCATED) broken();
  if (which & 4u && lidarcodec_give_weights(session, nullptr, 0) == LIDARCODEC_OK) broken();
  if (which & 8u) lidarcodec_give_weights(session, some.data(), some.size());
  if (which & 16u &&
      lidarcodec_push(session, some.data(), std::min<std::size_t>(some.size(), which), nullptr) == LIDARCODEC_OK)
    broken();
  if (which & 32u) lidarcodec_error_needs(session);
  if (lidarcodec_give_pictures(session, which % 8, which & 64u ? open_anything : nullptr, nullptr) ==
      (which % 8 < kPng ? LIDARCODEC_OK : LIDARCODEC_UNSUPPORTED))
    broken();
  if (lidarcodec_error_text(session) == nullptr || lidarcodec_error_offset(session) > some.size() + (1u << 30))
    broken();
}

void decode_by_c(const std::vector<Bytes8>& messages, unsigned calls) {
  lidarcodec_close(nullptr);
  lidarcodec_session* const session = lidarcodec_open();
  if (session == nullptr || lidarcodec_points(session, LIDARCODEC_ALL, nullptr, 0) != 0) broken();
  bool goes_on = false;
  for (std::uint16_t codec = kJxl; codec <= kH264Log; ++codec)
    if (lidarcodec_give_pictures(session, codec, open_anything, codec == kH264 ? &goes_on : nullptr) != LIDARCODEC_OK)
      broken();
  if (calls % 2 == 1) lidarcodec_give_pictures(session, kPng, open_anything, nullptr);
  MessageRepair repair;
  for (const Bytes8& given : messages) {
    const Bytes8 message = repair.repaired(given);
    if (calls != 0) call_anything(session, calls, repair.weights());
    const bool unwanted = (calls & 64u) != 0;  // points are asked for, the frame is not
    lidarcodec_frame frame{};
    const lidarcodec_status status =
        lidarcodec_push(session, message.data(), message.size(), unwanted ? nullptr : &frame);
    if (status >= LIDARCODEC_OUT_OF_MEMORY) broken();
    if (status != LIDARCODEC_OK) {
      if (frame.planes != nullptr || lidarcodec_next(session, nullptr) != 0 ||
          lidarcodec_points(session, LIDARCODEC_ALL, nullptr, 0) != 0 || *lidarcodec_error_text(session) == '\0')
        broken();
    } else if (!unwanted) {
      check_frame(session, frame);
      for (std::uint64_t before = frame.index; lidarcodec_next(session, &frame) == 1; before = frame.index) {
        if (frame.index <= before) broken();
        check_frame(session, frame);
      }
      repair.decoded(frame.index);
    }
    calls = (calls << 1 | calls >> 6) & 127u;
  }
  lidarcodec_close(session);
}

}  // namespace

extern "C" std::size_t LLVMFuzzerCustomMutator(std::uint8_t* data, std::size_t size, std::size_t most, unsigned seed) {
  return mutated_messages(data, size, most, seed);
}

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  FuzzInput input(data, size);
  const unsigned way = input.byte();
  const std::vector<Bytes8> messages = messages_of(input.rest());
  if (way % 2 == 0)
    decode_by_class(messages, way / 2);
  else
    decode_by_c(messages, way / 2);
  return 0;
}
