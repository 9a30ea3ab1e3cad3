#include "session/message.hpp"

#include <algorithm>
#include <array>

#include "base/crc32c.hpp"
#include "base/sha256.hpp"

namespace lidarcodec {
namespace {

constexpr std::array<std::uint8_t, 4> kMagic = {0x93, 'L', 'D', 'C'};
constexpr std::uint8_t kMajor = 1;
constexpr std::size_t kHeaderBytes = 56, kChecksumBytes = 4, kSectionHead = 6;
constexpr std::size_t kLeast = kHeaderBytes + kChecksumBytes;
constexpr std::uint64_t kMostFrames = 64, kMostPackets = 2048, kMostSections = 256;
constexpr std::uint64_t kKey = 1, kNeeds = 2, kPlanes = 0x100, kGoesOn = 0x200, kCritical = 0xFF00;
constexpr std::size_t kKnownTypes = 16;
constexpr std::array<const char*, kKnownTypes + 1> kTypes = {
    "",        "range", "mask",   "intensity", "azimuth",  "side",   "calibration", "keep", "motion",
    "weights", "pose",  "filler", "lattice",   "position", "planes", "rest",        "cloud"};
constexpr std::array<const char*, 12> kCodecs = {"",     "raw",          "zstd", "pcodec",   "png",    "jxl",
                                                 "jpeg", "jpeg-layered", "h264", "h264-log", "riddle", "predictive"};

std::string text(std::uint64_t number) { return std::to_string(number); }

void check(std::uint64_t value, std::uint64_t low, std::uint64_t high, const char* what, std::size_t at) {
  if (value < low || value > high)
    throw Error(ErrorCode::Header,
                std::string("message header: ") + what + " is " + text(value) + ", allowed is " + text(low) + " to " +
                    text(high),
                at);
}

// Magic and major version, which stay where they are in every version; then sizes and checksum.
void check_whole(Bytes data) {
  const Bytes begin = data.first(std::min(data.size(), kMagic.size()));
  if (!std::equal(begin.begin(), begin.end(), kMagic.begin()))
    throw Error(ErrorCode::Header, "not a message: it begins with " + hex(begin) + ", not " + hex(kMagic));
  if (data.size() <= kMagic.size())
    throw Error(ErrorCode::Truncated, "a message of " + text(data.size()) + " bytes ends within its version",
                data.size());
  if (data[4] != kMajor)
    throw Error(ErrorCode::Version,
                "message of format version " + text(data[4]) + ": this build reads version 1; update the older side",
                4);
  if (data.size() < kLeast)
    throw Error(ErrorCode::Truncated,
                "a message of " + text(data.size()) + " bytes is shorter than the shortest possible", data.size());
  const std::uint64_t total = little_endian(data, 8, 4);
  if (data.size() > kMostMessage || total < kLeast || data.size() > total)
    throw Error(ErrorCode::Header,
                "a message announces " + text(total) + " bytes, but has " + text(data.size()) + "; at most " +
                    text(kMostMessage) + " are allowed",
                8);
  if (data.size() < total)
    throw Error(ErrorCode::Truncated, "a message of " + text(total) + " bytes was cut off after " + text(data.size()),
                data.size());
  const std::size_t body = data.size() - kChecksumBytes;
  if (crc32c(data.data(), body) != little_endian(data, body, kChecksumBytes))
    throw Error(ErrorCode::Checksum, "the checksum of the message does not match", body);
}

}  // namespace

const char* name_of(Codec codec) {
  const auto number = static_cast<std::size_t>(codec);
  return number < kCodecs.size() ? kCodecs[number] : "";
}

bool Message::has(SectionType type) const {
  return std::any_of(sections.begin(), sections.end(),
                     [&](const Section& s) { return s.type == static_cast<std::uint8_t>(type) && s.ordinal == 0; });
}

Bytes Message::section(SectionType type) const {
  std::size_t count = 0;
  Bytes found;
  for (const Section& section : sections) {
    if (section.type != static_cast<std::uint8_t>(type) || section.ordinal != 0) continue;
    found = section.data;
    ++count;
  }
  if (count != 1)
    throw Error(ErrorCode::Section, std::string("a message must hold one ") + kTypes[static_cast<std::size_t>(type)] +
                                        " section, this one holds " + text(count));
  return found;
}

std::size_t Message::section_bytes() const {
  std::size_t sum = 0;
  for (const Section& section : sections) sum += section.data.size();
  return sum;
}

Message read_message(Bytes data) {
  check_whole(data);
  const std::uint64_t header = little_endian(data, 6, 2), flags = little_endian(data, 14, 2),
                      needs = little_endian(data, 40, 8);
  if ((flags & kCritical & ~(kPlanes | kGoesOn)) != 0)
    throw Error(ErrorCode::Version, "message with flags " + text(flags) + ": this build does not know all of them", 14);
  if (needs != 0 && (flags & kNeeds) == 0)
    throw Error(ErrorCode::Header, "message header: names frame " + text(needs) + " without the flag that it needs one",
                40);
  check(header, kHeaderBytes, data.size() - kChecksumBytes, "header size", 6);
  Message message;
  message.codec = static_cast<Codec>(little_endian(data, 12, 2));
  message.key = (flags & kKey) != 0;
  message.planes = (flags & kPlanes) != 0;
  message.stream_id = little_endian(data, 16, 8);
  message.stamp_ns = static_cast<std::int64_t>(little_endian(data, 24, 8));
  message.frame_index = little_endian(data, 32, 8);
  message.frame_count = little_endian(data, 48, 2);
  message.width = little_endian(data, 50, 2);
  message.packets = little_endian(data, 52, 2);
  const std::size_t count = little_endian(data, 54, 2);
  check(message.frame_index, 0, (std::uint64_t{1} << 63) - 1, "frame index", 32);
  check(message.frame_count, 1, kMostFrames, "frame count", 48);
  check(message.width, 0, kMostColumns, "width", 50);
  check(message.packets, 0, kMostPackets, "packet count", 52);
  check(count, 0, kMostSections, "section count", 54);
  if ((flags & kNeeds) != 0) {
    if (message.key)
      throw Error(ErrorCode::Header, "message header: a key message that needs frame " + text(needs), 14);
    if (needs >= message.frame_index)
      throw Error(ErrorCode::Header,
                  "message header: frame " + text(message.frame_index) + " needs frame " + text(needs), 40);
    message.needs = needs;
  }
  message.goes_on = (flags & kGoesOn) != 0;
  if (message.goes_on &&
      (message.planes || message.frame_count != 1 || !message.needs || *message.needs + 1 != message.frame_index))
    throw Error(ErrorCode::Header, "message header: a part of a turn that does not go on from the frame before", 14);

  const std::size_t end = data.size() - kChecksumBytes;
  std::size_t at = header;
  for (std::size_t number = 0; number < count; ++number) {
    if (end - at < kSectionHead)
      throw Error(ErrorCode::Truncated,
                  "section " + text(number) + " of " + text(count) + " begins beyond the end of the message", at);
    const std::uint8_t type = data[at], ordinal = data[at + 1];
    const std::size_t length = little_endian(data, at + 2, 4);
    if (type >= 1 && type <= kKnownTypes && ordinal >= message.frame_count)
      throw Error(ErrorCode::Section,
                  "section " + text(number) + " belongs to frame " + text(ordinal) + " of " + text(message.frame_count),
                  at + 1);
    at += kSectionHead;
    if (end - at < length)
      throw Error(ErrorCode::Truncated,
                  "section " + text(number) + " announces " + text(length) + " bytes, " + text(end - at) + " are left",
                  at - 4);
    message.sections.push_back({type, ordinal, data.subspan(at, length)});
    at += length;
  }
  if (at != end) throw Error(ErrorCode::Section, text(end - at) + " bytes after the last section", at);
  return message;
}

}  // namespace lidarcodec
