#include "session/pictures/jpeg.hpp"

#include <array>
#include <string>

namespace lidarcodec {
namespace {

constexpr std::size_t kHeadBytes = 6, kMarkerBytes = 2, kSizeBytes = 2, kFrameBytes = 9;
constexpr unsigned kMappings = 3;             // those of a JPEG are the first three
constexpr std::size_t kSamplesPerByte = 256;  // a block of 64 samples takes two bits or more
constexpr std::uint8_t kStart = 0xD8, kScan = 0xDA, kSteps = 0xDB, kHuffman = 0xC4, kComment = 0xFE;

[[noreturn]] void damaged(const std::string& what) { throw Error(ErrorCode::Section, what); }

bool is_skipped(std::uint8_t marker) {
  return marker == kSteps || marker == kHuffman || marker == kComment || (marker >= 0xE0 && marker <= 0xEF);
}

std::size_t big_endian(Bytes data, std::size_t at) { return std::size_t{data[at]} << 8 | data[at + 1]; }

// Sequential, one component, of these sides and bits. Raises Section.
void check_jpeg(Bytes data, std::size_t rows, std::size_t width, unsigned bits) {
  if (data.size() < 2 || data[0] != 0xFF || data[1] != kStart) damaged("a JPEG that does not begin as one");
  std::size_t at = 2;
  for (bool seen = false;;) {
    if (data.size() - at < kMarkerBytes + kSizeBytes || data[at] != 0xFF)
      damaged("a JPEG without a marker at byte " + std::to_string(at));
    const std::uint8_t marker = data[at + 1];
    const std::size_t size = big_endian(data, at + kMarkerBytes);
    if (size < kSizeBytes || data.size() - at - kMarkerBytes < size)
      damaged("a JPEG that ends within a segment at byte " + std::to_string(at));
    const Bytes segment = data.subspan(at + kMarkerBytes + kSizeBytes, size - kSizeBytes);
    if (marker == kScan) {
      if (!seen) damaged("a JPEG that says no size before its scan");
      break;
    }
    if ((marker == 0xC0 || marker == 0xC1) && !seen) {
      if (segment.size() != kFrameBytes || segment[0] != bits || big_endian(segment, 1) != rows ||
          big_endian(segment, 3) != width || segment[5] != 1)
        damaged("a JPEG that is not one component of " + std::to_string(width) + " x " + std::to_string(rows) +
                " samples of " + std::to_string(bits) + " bits");
      seen = true;
    } else if (!is_skipped(marker)) {
      damaged("a JPEG with marker " + std::to_string(marker) + ": only sequential ones are read");
    }
    at += kMarkerBytes + size;
  }
  if ((data.size() - at) * kSamplesPerByte < rows * width)
    damaged("a JPEG of " + std::to_string(width) + " x " + std::to_string(rows) + " samples in " +
            std::to_string(data.size() - at) + " bytes");
}

}  // namespace

JpegSamples split_samples(Bytes data, RangeScale scale) {
  if (data.size() < kHeadBytes)
    damaged("a range section of " + std::to_string(data.size()) + " bytes ends before its samples are known");
  const unsigned bits = data[0];
  const auto top = static_cast<std::uint32_t>(little_endian(data, 2, 4));
  if ((bits != 8 && bits != 12) || data[1] >= kMappings)
    damaged("samples of " + std::to_string(bits) + " bits by mapping " + std::to_string(data[1]));
  if (top < 1 || top > scale.most)
    damaged("samples for ranges up to " + std::to_string(top) + ": 1 to " + std::to_string(scale.most) +
            " are possible");
  return {bits, ranges_of_samples(static_cast<Mapping>(data[1]), bits, top, scale.step_um), data.subspan(kHeadBytes)};
}

std::vector<std::uint16_t> read_jpeg(const Outside& outside, const Picture& jpeg) {
  check_jpeg(jpeg.data, jpeg.rows, jpeg.width, jpeg.bits);
  return mapped_samples(outside, jpeg);
}

}  // namespace lidarcodec
