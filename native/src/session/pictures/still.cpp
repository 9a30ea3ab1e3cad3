#include "session/pictures/still.hpp"

#include <algorithm>
#include <string>

#include "session/pictures/canvas.hpp"
#include "session/pictures/jpeg.hpp"
#include "session/pictures/sent_cells.hpp"
#include "session/ranges.hpp"

namespace lidarcodec {
namespace {

constexpr std::int32_t kMostRange = 65'535;

void check_empty(Bytes data) {
  if (!data.empty()) throw Error(ErrorCode::Section, std::to_string(data.size()) + " bytes of ranges for no return");
}

// Indices of ranges on one scale, which wrap at 65536.
void put_jxl(Bytes section, const Outside& outside, const Sensor& sensor, Planes& planes) {
  const auto [step, data] = split_step(section);
  if (!planes.any_return()) return check_empty(data);
  const auto [canvas, codestream] = split_canvas(data, sensor, planes, 1);
  const std::vector<std::uint16_t> samples = samples_of(outside, {Codec::Jxl, codestream, kRows, canvas.width});
  for (std::size_t row = 0; row < kRows; ++row) {
    const std::uint32_t added = (static_cast<std::uint32_t>(sensor.level[row]) + step / 2) / step;
    for (std::size_t c = 0; c < planes.width; ++c)
      if (const std::size_t cell = row * planes.width + c; planes.returns[cell] != 0)
        planes.range[cell] =
            range_of_index(static_cast<std::uint16_t>(samples[canvas.place(sensor, row, c)] - added), step);
  }
}

void put_jpeg(Bytes section, const Outside& outside, const Sensor& sensor, Planes& planes) {
  if (!planes.any_return()) return check_empty(section);
  const JpegSamples mapped = split_samples(section, kCanvasScale);
  const auto [canvas, jpeg] = split_canvas(mapped.rest, sensor, planes, kJpegBlock);
  const std::vector<std::uint16_t> samples = read_jpeg(outside, {Codec::Jpeg, jpeg, kRows, canvas.width, mapped.bits});
  for (std::size_t row = 0; row < kRows; ++row)
    for (std::size_t c = 0; c < planes.width; ++c)
      if (const std::size_t cell = row * planes.width + c; planes.returns[cell] != 0)
        planes.range[cell] = static_cast<std::uint16_t>(
            std::clamp(mapped.range[samples[canvas.place(sensor, row, c)]] - sensor.level[row], 1, kMostRange));
}

}  // namespace

void put_still_ranges(const Message& message, const Outside& outside, const Sensor& sensor, Planes& planes) {
  const Bytes section = message.section(SectionType::Range);
  return message.codec == Codec::Jxl ? put_jxl(section, outside, sensor, planes)
                                     : put_jpeg(section, outside, sensor, planes);
}

void put_still_ranges(const Message& message, const Outside& outside, ImageFrame& frame) {
  const auto [bits, data] = split_picture_head(message.section(SectionType::Range));
  SentCells cells(frame);
  if (message.needs) throw Error(ErrorCode::Section, "a picture that needs frame " + std::to_string(*message.needs));
  if (!cells.any_return()) return check_empty(data);
  const JpegSamples mapped = split_samples(data, cells.scale(bits));
  const std::size_t columns = cells.columns(), width = whole_blocks(columns);
  const std::vector<std::uint16_t> samples =
      read_jpeg(outside, {message.codec, mapped.rest, whole_blocks(cells.rows()), width, mapped.bits});
  cells.put(bits, [&](std::size_t row, std::size_t sent) {
    const auto round = static_cast<std::int64_t>(columns);
    const std::int64_t place = (static_cast<std::int64_t>(sent) + cells.shift(row)) % round;
    return mapped.range[samples[row * width + static_cast<std::size_t>(place < 0 ? place + round : place)]];
  });
}

}  // namespace lidarcodec
