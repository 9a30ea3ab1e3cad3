#include "session/pictures/group.hpp"

#include <algorithm>
#include <limits>
#include <string>

#include "base/varint.hpp"
#include "session/pictures/jpeg.hpp"
#include "session/pictures/sent_cells.hpp"

namespace lidarcodec {
namespace {

constexpr std::size_t kMostGroup = 32, kTurnBytes = 2, kMemberBytes = 20, kMostNumbers = std::size_t{1} << 26;
constexpr std::uint64_t kMostSamples = std::uint64_t{1} << 24, kMostPlaneCount = 12, kMostStep = 40'001;
constexpr std::int64_t kLastStamp = std::numeric_limits<std::int64_t>::max();
constexpr std::int64_t kFirstStamp = std::numeric_limits<std::int64_t>::min();
constexpr std::int32_t kMostRange = 65'535;

[[noreturn]] void damaged(const std::string& what) { throw Error(ErrorCode::Section, what); }

// The stamp of a frame so much later, if there can be one.
std::int64_t later(std::int64_t stamp_ns, std::int64_t by) {
  if (by > 0 ? stamp_ns > kLastStamp - by : stamp_ns < kFirstStamp - by)
    damaged("a frame of a group beyond the end of time");
  return stamp_ns + by;
}

// Where the columns of a group lie in its picture.
class Layers {
 public:
  // widths: columns of each frame that are sent. Raises Section.
  Layers(const Group& group, std::size_t lasers, const std::vector<std::size_t>& widths)
      : turn_(group.turn), starts_(group.starts), lasers_(lasers) {
    std::uint64_t end = 0;
    for (std::size_t frame = 0; frame < widths.size(); ++frame) {
      if (starts_[frame] < end)
        damaged("a frame that begins at column " + std::to_string(starts_[frame]) + " of its group, before " +
                std::to_string(end));
      end = starts_[frame] + widths[frame];
    }
    if (turn_ > kMostColumns || (end != 0 && turn_ == 0))
      damaged(std::to_string(end) + " columns in turns of " + std::to_string(turn_));
    if (end == 0) return;
    const std::uint64_t height = whole_blocks((end + turn_ - 1) / turn_), width = whole_blocks(turn_);
    if (height > kMostSamples / (lasers * width))
      damaged("a group of " + std::to_string(height) + " turns of " + std::to_string(turn_) +
              " columns, more than a picture holds");
    height_ = height;
    width_ = width;
  }

  std::size_t rows() const { return lasers_ * height_; }
  std::size_t width() const { return width_; }
  // Of a cell of a frame in the picture.
  std::size_t place(std::size_t frame, std::size_t row, std::size_t column) const {
    const std::uint64_t at = starts_[frame] + column;
    return (row * height_ + at / turn_) * width_ + at % turn_;
  }

 private:
  std::size_t turn_;
  const std::vector<std::uint64_t>& starts_;
  std::size_t lasers_, height_ = 0, width_ = 0;
};

void check_empty(Bytes data) {
  if (!data.empty()) damaged(std::to_string(data.size()) + " bytes of ranges for no return");
}

}  // namespace

void check_group(const Message& message) {
  if (message.frame_count > kMostGroup || message.needs)
    damaged("a group of " + std::to_string(message.frame_count) + " frames, or one that needs another");
}

Group split_group(Bytes data, const Message& message) {
  const std::size_t size = kTurnBytes + message.frame_count * kMemberBytes;
  if (data.size() < size)
    damaged("a range section of " + std::to_string(data.size()) + " bytes for " + std::to_string(message.frame_count) +
            " frames");
  Group group;
  group.turn = little_endian(data, 0, kTurnBytes);
  group.rest = data.subspan(size);
  std::uint64_t last = 0;
  for (std::size_t ordinal = 0; ordinal < message.frame_count; ++ordinal) {
    const Bytes member = data.subspan(kTurnBytes + ordinal * kMemberBytes, kMemberBytes);
    const std::uint64_t index = little_endian(member, 0, 4);
    const auto by = static_cast<std::int64_t>(little_endian(member, 4, 8));
    if (ordinal == 0 ? index != 0 || by != 0 : index <= last)
      damaged("frame " + std::to_string(index) + " of a group after frame " + std::to_string(last));
    last = index;
    Message alone = message;
    alone.frame_count = 1;
    alone.frame_index += index;
    if (alone.frame_index >> 63 != 0) damaged("a frame of a group beyond the end of time");
    alone.stamp_ns = later(message.stamp_ns, by);
    alone.width = little_endian(member, 12, 2);
    alone.packets = little_endian(member, 14, 2);
    if (alone.width > message.width || alone.packets > message.packets)
      damaged("a frame of " + std::to_string(alone.width) + " columns and " + std::to_string(alone.packets) +
              " packets in a message of narrower ones");
    alone.sections.clear();
    for (const Section& section : message.sections)
      if (section.ordinal == ordinal) alone.sections.push_back({section.type, 0, section.data});
    group.starts.push_back(little_endian(member, 16, 4));
    group.alone.push_back(std::move(alone));
  }
  return group;
}

void check_sizes(const Group& group) {
  std::size_t numbers = 0;
  for (const Message& alone : group.alone) {
    if (!alone.has(SectionType::Planes)) continue;
    VarintReader reader(alone.section(SectionType::Planes), "planes");
    reader.byte();
    const std::size_t rows = std::size_t{reader.byte()} + 1;
    reader.number(kMostStep, 1);
    numbers += rows * alone.width * reader.number(kMostPlaneCount, 1);
  }
  if (numbers > kMostNumbers)
    damaged("a group of " + std::to_string(numbers) + " numbers in planes: " + std::to_string(kMostNumbers) +
            " are possible");
}

void check_layers(const Group& group, std::size_t rows, const std::vector<std::size_t>& widths) {
  Layers(group, rows, widths);
}

void put_group_ranges(const Group& group, const Outside& outside, const std::vector<Planes*>& frames) {
  if (std::none_of(frames.begin(), frames.end(), [](const Planes* planes) { return planes->any_return(); }))
    return check_empty(group.rest);
  std::vector<std::size_t> widths;
  for (const Planes* planes : frames) widths.push_back(planes->width);
  const Layers layers(group, kRows, widths);
  const JpegSamples mapped = split_samples(group.rest, kCanvasScale);
  const std::vector<std::uint16_t> samples =
      read_jpeg(outside, {Codec::JpegLayered, mapped.rest, layers.rows(), layers.width(), mapped.bits});
  for (std::size_t frame = 0; frame < frames.size(); ++frame) {
    Planes& planes = *frames[frame];
    for (std::size_t row = 0; row < kRows; ++row)
      for (std::size_t c = 0; c < planes.width; ++c)
        if (const std::size_t cell = row * planes.width + c; planes.returns[cell] != 0)
          planes.range[cell] =
              static_cast<std::uint16_t>(std::clamp(mapped.range[samples[layers.place(frame, row, c)]], 1, kMostRange));
  }
}

void put_group_ranges(const Group& group, std::uint32_t bits, const Outside& outside,
                      const std::vector<ImageFrame*>& frames) {
  std::vector<SentCells> cells;
  std::vector<std::size_t> widths;
  for (ImageFrame* const frame : frames) widths.push_back(cells.emplace_back(*frame).columns());
  if (std::none_of(cells.begin(), cells.end(), [](const SentCells& one) { return one.any_return(); }))
    return check_empty(group.rest);
  const Layers layers(group, cells[0].rows(), widths);
  const JpegSamples mapped = split_samples(group.rest, cells[0].scale(bits));
  const std::vector<std::uint16_t> samples =
      read_jpeg(outside, {Codec::JpegLayered, mapped.rest, layers.rows(), layers.width(), mapped.bits});
  for (std::size_t frame = 0; frame < cells.size(); ++frame)
    cells[frame].put(
        bits, [&](std::size_t row, std::size_t sent) { return mapped.range[samples[layers.place(frame, row, sent)]]; });
}

}  // namespace lidarcodec
