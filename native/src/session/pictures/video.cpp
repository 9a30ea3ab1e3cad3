#include "session/pictures/video.hpp"

#include <algorithm>
#include <string>

#include "session/pictures/canvas.hpp"
#include "session/pictures/h264_units.hpp"
#include "session/pictures/mapping.hpp"
#include "session/pictures/sent_cells.hpp"

namespace lidarcodec {
namespace {

constexpr std::size_t kHeadBytes = 10;
constexpr std::uint8_t kMappings = 4;
constexpr std::int32_t kMostRange = 65'535;
constexpr std::int64_t kTurn = 628'318'531;

[[noreturn]] void damaged(const std::string& what) { throw Error(ErrorCode::Section, what); }

void check_empty(const Message& message, Bytes data) {
  if (!data.empty() || message.needs) damaged(std::to_string(data.size()) + " bytes of ranges for no return");
}

// Head of a RANGE section, and its access unit. rows: of the sensor. Raises Section.
std::pair<VideoHead, Bytes> split_head(Bytes data, std::size_t rows, RangeScale scale) {
  if (data.size() < kHeadBytes)
    damaged("a range section of " + std::to_string(data.size()) + " bytes ends before its pictures are known");
  VideoHead head;
  head.bits = data[0];
  head.mapping = data[1];
  head.top = static_cast<std::uint32_t>(little_endian(data, 2, 4));
  head.layout = {static_cast<std::size_t>(little_endian(data, 6, 2)), data[8], data[9] == 1, rows};
  if ((head.bits != 8 && head.bits != 10) || head.mapping >= kMappings || data[9] > 1)
    damaged("pictures of " + std::to_string(head.bits) + " bits by mapping " + std::to_string(head.mapping) +
            ", anchored " + std::to_string(data[9]));
  head.layout.check();
  if (head.top < 1 || head.top > scale.most)
    damaged("samples for ranges up to " + std::to_string(head.top) + ": 1 to " + std::to_string(scale.most) +
            " are possible");
  return {head, data.subspan(kHeadBytes)};
}

// The place of a cell, moved by a number of columns round all bands.
std::size_t moved(std::size_t place, std::int64_t columns, std::size_t places) {
  const auto round = static_cast<std::int64_t>(places);
  const std::int64_t to = (static_cast<std::int64_t>(place) + columns) % round;
  return static_cast<std::size_t>(to < 0 ? to + round : to);
}

std::vector<std::int32_t> ranges_of(const VideoHead& head, RangeScale scale) {
  return ranges_of_samples(static_cast<Mapping>(head.mapping), head.bits, head.top, scale.step_um);
}

}  // namespace

void Video::check(const Message& message) const {
  if (message.needs && read_ != message.needs)
    throw Error(ErrorCode::Reference,
                "frame " + std::to_string(message.frame_index) + " needs frame " + std::to_string(*message.needs) +
                    ", which was not decoded: ask for a key frame",
                *message.needs);
}

std::vector<std::uint16_t> Video::samples(const Message& message, const Outside& outside, const VideoHead& head,
                                          Bytes unit) {
  read_.reset();  // after any error only an IDR picture is taken
  if (message.needs && head != head_) damaged("a picture unlike the one that it refers to");
  const TurnLayout& layout = head.layout;
  const Picture picture{message.codec,  unit,      layout.band_rows() * layout.bands,
                        layout.columns, head.bits, !message.needs};
  check_h264(picture);
  std::vector<std::uint16_t> found = mapped_samples(outside, picture);
  head_ = head;
  read_ = message.frame_index;
  return found;
}

void Video::put_ranges(const Message& message, const Outside& outside, const Sensor& sensor, Planes& planes) {
  const Bytes section = message.section(SectionType::Range);
  if (!planes.any_return()) return check_empty(message, section);
  const auto [head, unit] = split_head(section, kRows, kCanvasScale);
  const TurnLayout& layout = head.layout;
  std::array<std::vector<std::size_t>, 2> places;
  for (std::size_t half = 0; half < 2; ++half) {
    const auto from = static_cast<std::ptrdiff_t>(half * planes.width),
               to = from + static_cast<std::ptrdiff_t>(planes.width);
    places[half] = places_of(layout, {planes.azimuth.begin() + from, planes.azimuth.begin() + to},
                             {planes.fired.begin() + from, planes.fired.begin() + to});
  }
  const std::vector<std::uint16_t> picture = samples(message, outside, head, unit);
  const std::vector<std::int32_t> range = ranges_of(head, kCanvasScale);
  const std::array<std::int64_t, kRows> angle = angles_of_rows(sensor);
  for (std::size_t row = 0; row < kRows; ++row) {
    const std::int64_t twice = 2 * angle[row] * static_cast<std::int64_t>(layout.columns) + kTurn;
    const std::int64_t down = twice / (2 * kTurn) - static_cast<std::int64_t>(twice % (2 * kTurn) < 0);
    const std::int64_t shift = layout.anchored ? down : 0;
    const std::vector<std::size_t>& of_half = places[sensor.beams.half[row]];
    for (std::size_t c = 0; c < planes.width; ++c) {
      const std::size_t cell = row * planes.width + c;
      if (planes.returns[cell] == 0) continue;
      const std::size_t at = layout.cell(row, moved(of_half[c], shift, layout.places()));
      planes.range[cell] =
          static_cast<std::uint16_t>(std::clamp(range[picture[at]] - sensor.level[row], 1, kMostRange));
    }
  }
}

void Video::put_ranges(const Message& message, const Outside& outside, ImageFrame& frame) {
  const auto [bits, data] = split_picture_head(message.section(SectionType::Range));
  SentCells cells(frame);
  if (!cells.any_return()) return check_empty(message, data);
  check(message);
  const RangeScale scale = cells.scale(bits);
  const auto [head, unit] = split_head(data, cells.rows(), scale);
  const TurnLayout& layout = head.layout;
  std::vector<std::uint16_t> azimuth;
  for (std::size_t sent = 0; sent < cells.columns(); ++sent) azimuth.push_back(cells.azimuth(sent));
  const std::vector<std::size_t> places = places_of(layout, azimuth, {});
  const std::vector<std::uint16_t> picture = samples(message, outside, head, unit);
  const std::vector<std::int32_t> range = ranges_of(head, scale);
  cells.put(bits, [&](std::size_t row, std::size_t sent) {
    const std::int64_t shift = layout.anchored ? cells.shift(row) : 0;
    return range[picture[layout.cell(row, moved(places[sent], shift, layout.places()))]];
  });
}

}  // namespace lidarcodec
