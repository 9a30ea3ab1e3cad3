#include "session/pictures/h264_units.hpp"

#include <algorithm>
#include <string>
#include <vector>

namespace lidarcodec {
namespace {

constexpr std::uint8_t kSlice = 1, kIdrSlice = 5, kSequence = 7, kPicture = 8;
constexpr std::size_t kStartBytes = 3, kLongestParameters = 512, kMostUnits = 3;
constexpr std::uint32_t kMostReferences = 16;

[[noreturn]] void damaged(const std::string& what) { throw Error(ErrorCode::Section, what); }

// Whether three bytes at a place are two zeros and this one.
bool is_at(Bytes data, std::size_t at, std::uint8_t third) {
  return data.size() - at >= kStartBytes && data[at] == 0 && data[at + 1] == 0 && data[at + 2] == third;
}

// The NAL units without zeros at their ends; one more than there may be at most.
std::vector<Bytes> split_units(Bytes data) {
  std::vector<Bytes> units;
  std::size_t begin = 0;
  bool started = false;
  const auto end_unit = [&](std::size_t end) {
    Bytes unit = data.subspan(begin, end - begin);
    while (!unit.empty() && unit.back() == 0) unit = unit.first(unit.size() - 1);
    if (started)
      units.push_back(unit);
    else if (!unit.empty())
      damaged("an H.264 access unit that does not begin with a start code");
  };
  for (std::size_t at = 0; at < data.size() && units.size() <= kMostUnits; ++at) {
    if (!is_at(data, at, 1)) continue;
    end_unit(at);
    started = true;
    begin = at + kStartBytes;
    at = begin - 1;
  }
  if (!started) damaged("an H.264 access unit that does not begin with a start code");
  if (units.size() <= kMostUnits) end_unit(data.size());
  return units;
}

// Reads numbers of a NAL unit, bit by bit.
class BitReader {
 public:
  explicit BitReader(Bytes unit) {
    for (std::size_t at = 0; at < unit.size();) {
      const bool is_escaped = is_at(unit, at, 3);  // 0 0 3 stands for 0 0
      plain_.push_back(unit[at]);
      if (is_escaped) plain_.push_back(0);
      at += is_escaped ? kStartBytes : 1;
    }
  }

  // At most 32.
  std::uint32_t number(unsigned bits) {
    if (8 * plain_.size() - at_ < bits) damaged("H.264 sequence parameters that end too early");
    std::uint32_t value = 0;
    for (; bits > 0; --bits, ++at_) value = value << 1 | (plain_[at_ / 8] >> (7 - at_ % 8) & 1u);
    return value;
  }

  // Of the form ue(v).
  std::uint32_t golomb() {
    unsigned zeros = 0;
    while (number(1) == 0)
      if (++zeros > 31) damaged("H.264 sequence parameters with a number that has no end");
    return (std::uint32_t{1} << zeros) - 1 + number(zeros);
  }

 private:
  std::vector<std::uint8_t> plain_;
  std::size_t at_ = 0;
};

void check_sequence(Bytes unit, const Picture& picture) {
  if (unit.size() > kLongestParameters)
    damaged("H.264 sequence parameters of " + std::to_string(unit.size()) + " bytes");
  BitReader read(unit.subspan(1));
  const std::uint32_t profile = read.number(8);
  read.number(16);
  if (const std::uint32_t which = read.golomb(); (profile != 100 && profile != 110) || which > 31)
    damaged("H.264 of profile " + std::to_string(profile) + ", parameters " + std::to_string(which));
  const std::uint32_t chroma = read.golomb(), luma_more = read.golomb(), chroma_more = read.golomb();
  const std::uint32_t bypass = read.number(1), scaling = read.number(1), more = picture.bits - 8;
  if (chroma != 0 || luma_more != more || (chroma_more != 0 && chroma_more != more) || bypass != 0 || scaling != 0)
    damaged("H.264 pictures of chroma format " + std::to_string(chroma) + ", not one plane of " +
            std::to_string(picture.bits) + " bits");
  if (read.golomb() > 12) damaged("H.264 sequence parameters with frame numbers of more than 16 bits");
  const std::uint32_t order = read.golomb();
  if (order == 0 && read.golomb() > 12) damaged("H.264 sequence parameters with picture orders of more than 16 bits");
  if (const std::uint32_t references = read.golomb(); (order != 0 && order != 2) || references > kMostReferences)
    damaged("H.264 of picture order " + std::to_string(order) + ", " + std::to_string(references) + " references");
  read.number(1);
  const std::uint64_t width = 16 * (std::uint64_t{read.golomb()} + 1), rows = 16 * (std::uint64_t{read.golomb()} + 1);
  const std::uint32_t whole_frames = read.number(1);
  read.number(1);
  if (width != picture.width || rows != picture.rows || whole_frames != 1 || read.number(1) != 0)
    damaged("H.264 pictures of " + std::to_string(width) + " x " + std::to_string(rows) +
            " samples: " + std::to_string(picture.width) + " x " + std::to_string(picture.rows) + " are expected");
}

}  // namespace

void check_h264(const Picture& picture) {
  const std::vector<Bytes> units = split_units(picture.data);
  const std::vector<std::uint8_t> wanted =
      picture.begins ? std::vector<std::uint8_t>{kSequence, kPicture, kIdrSlice} : std::vector<std::uint8_t>{kSlice};
  const auto type = [](Bytes unit) {
    return unit.empty() ? std::uint8_t{0} : static_cast<std::uint8_t>(unit[0] & 31u);
  };
  if (!std::equal(units.begin(), units.end(), wanted.begin(), wanted.end(),
                  [&](Bytes unit, std::uint8_t one) { return type(unit) == one; }))
    damaged("an H.264 access unit with other NAL units than those of one picture");
  if (picture.begins) check_sequence(units[0], picture);
}

}  // namespace lidarcodec
