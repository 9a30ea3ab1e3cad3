// Streams of messages as a fuzzer's input: a byte that says how they are decoded, then each message behind its length,
// u32. How they are changed inside of their sections, and how what a message says of itself is made right again
// (docs/wire-format.md).
#pragma once
#include <zlib.h>
#include <zstd.h>

#include <algorithm>
#include <random>
#include <string>
#include <vector>

#include "base/crc32c.hpp"
#include "base/sha256.hpp"
#include "fuzz_input.hpp"
#include "network/update.hpp"
#include "session/message.hpp"

using Bytes8 = std::vector<std::uint8_t>;

extern "C" __attribute__((weak)) std::size_t LLVMFuzzerMutate(std::uint8_t* data, std::size_t size, std::size_t most);

inline constexpr std::size_t kFuzzHeader = 56, kFuzzSectionHead = 6, kFuzzChecksum = 4, kFuzzMessages = 6;

inline void put_little_endian(Bytes8& to, std::size_t at, std::uint64_t value, std::size_t bytes) {
  for (std::size_t i = 0; i < bytes; ++i) to[at + i] = static_cast<std::uint8_t>(value >> (8 * i));
}

// A message in parts that can be changed and joined again.
struct LooseMessage {
  struct Part {
    std::uint8_t type = 0, ordinal = 0;
    Bytes8 data;
  };
  Bytes8 header;
  std::vector<Part> parts;

  // Takes what can be taken: header and sections as far as they go, the last one as long as there are bytes.
  explicit LooseMessage(const Bytes8& data)
      : header(data.begin(), data.begin() + static_cast<std::ptrdiff_t>(std::min(data.size(), kFuzzHeader))) {
    header.resize(kFuzzHeader);
    const std::size_t end = data.size() < kFuzzHeader + kFuzzChecksum ? 0 : data.size() - kFuzzChecksum;
    for (std::size_t at = kFuzzHeader; at + kFuzzSectionHead <= end;) {
      const std::size_t length =
          std::min<std::size_t>(lidarcodec::little_endian(data, at + 2, 4), end - at - kFuzzSectionHead);
      const auto from = data.begin() + static_cast<std::ptrdiff_t>(at + kFuzzSectionHead);
      parts.push_back({data[at], data[at + 1], {from, from + static_cast<std::ptrdiff_t>(length)}});
      at += kFuzzSectionHead + length;
    }
  }

  Bytes8 joined() const {
    Bytes8 message = header;
    for (const Part& part : parts) {
      message.insert(message.end(), {part.type, part.ordinal, 0, 0, 0, 0});
      put_little_endian(message, message.size() - 4, part.data.size(), 4);
      message.insert(message.end(), part.data.begin(), part.data.end());
    }
    message.resize(message.size() + kFuzzChecksum);
    return message;
  }
};

inline std::vector<Bytes8> messages_of(const Bytes8& data) {
  std::vector<Bytes8> messages;
  for (std::size_t at = 0; at + 4 <= data.size() && messages.size() < kFuzzMessages;) {
    const std::size_t length = std::min<std::size_t>(lidarcodec::little_endian(data, at, 4), data.size() - at - 4);
    const auto from = data.begin() + static_cast<std::ptrdiff_t>(at + 4);
    messages.emplace_back(from, from + static_cast<std::ptrdiff_t>(length));
    at += 4 + length;
  }
  return messages;
}

// Makes right what the messages of a stream say of themselves and of those before them.
class MessageRepair {
 public:
  Bytes8 repaired(const Bytes8& given) {
    LooseMessage message(given);
    Bytes8& header = message.header;
    const std::array<std::uint8_t, 5> begin = {0x93, 'L', 'D', 'C', 1};
    std::copy(begin.begin(), begin.end(), header.begin());
    put_little_endian(header, 6, kFuzzHeader, 2);
    if (const std::uint64_t width = lidarcodec::little_endian(header, 50, 2); width > kMostWidth && header[5] % 64 != 1)
      put_little_endian(header, 50, width % kMostWidth, 2);  // wider ones take longer and show nothing else
    if (header[14] & 2u && last_ && header[5] % 4 == 0) {
      put_little_endian(header, 32, *last_ + 1, 8);
      put_little_endian(header, 40, *last_, 8);
    }
    joins_late_ = header[5] % 4 == 2;
    for (LooseMessage::Part& part : message.parts) repair_names(part, header[5]);
    for (LooseMessage::Part& part : message.parts)
      if (part.type == static_cast<std::uint8_t>(lidarcodec::SectionType::Range) && is_riddle(header) &&
          !name_.empty() && part.data.size() >= kNameAt + kNameBytes)
        std::copy(name_.begin(), name_.end(), part.data.begin() + kNameAt);
    put_little_endian(header, 54, message.parts.size(), 2);
    Bytes8 whole = message.joined();
    put_little_endian(whole, 8, whole.size(), 4);
    put_little_endian(whole, whole.size() - kFuzzChecksum,
                      lidarcodec::crc32c(whole.data(), whole.size() - kFuzzChecksum), kFuzzChecksum);
    return whole;
  }

  // A frame of this index can be referred to.
  void decoded(std::uint64_t index) { last_ = std::min(index, kMostIndex); }

  // Whether the last message asks for a calibration that is given from outside; the last table, and the last weights,
  // of the stream.
  bool joins_late() const { return joins_late_; }
  const Bytes8& calibration() const { return calibration_; }
  const Bytes8& weights() const { return weights_; }

 private:
  static constexpr std::size_t kMostWidth = 192, kNameAt = 3, kNameBytes = 8, kTableBytes = 11 * 64 * 4,
                               kTableHead = 15;
  static constexpr std::uint64_t kMostIndex = (std::uint64_t{1} << 62);

  static bool is_riddle(const Bytes8& header) {
    return lidarcodec::little_endian(header, 12, 2) == static_cast<std::uint64_t>(lidarcodec::Codec::Riddle);
  }

  // The hash of a sensor that describes itself in a zstd frame.
  static void repair_described(Bytes8& data) {
    constexpr std::size_t kFrameAt = 13, kHead = 12, kMost = std::size_t{1} << 20;
    if (data.size() < kFrameAt) return;
    const std::size_t size = lidarcodec::little_endian(data, 9, 4);
    if (size < kHead || size > kMost) return;
    Bytes8 plain(size);
    if (ZSTD_decompress(plain.data(), size, data.data() + kFrameAt, data.size() - kFrameAt) != size) return;
    const std::size_t name = plain[5], model = plain[6], rows = plain[7],
                      description = lidarcodec::little_endian(plain, 8, 4), table = 11 * 4 * rows;
    if (kHead + name + model + description + table != size) return;
    const auto at = [&](std::size_t place) { return plain.begin() + static_cast<std::ptrdiff_t>(kHead + place); };
    Bytes8 hashed(at(0), at(name));
    hashed.push_back(0);
    hashed.insert(hashed.end(), at(name + model + description), plain.end());
    hashed.push_back(0);
    hashed.insert(hashed.end(), at(name), at(name + model));
    hashed.push_back(0);
    hashed.insert(hashed.end(), at(name + model), at(name + model + description));
    std::copy_n(lidarcodec::sha256(hashed).begin(), kNameBytes, data.begin() + 1);
  }

  // Checksums of the parts of a PNG.
  static void repair_png(Bytes8& data) {
    constexpr std::array<std::uint8_t, 4> kBegin = {137, 'P', 'N', 'G'};
    constexpr std::size_t kSignature = 8, kAround = 12;
    const auto found = std::search(data.begin(), data.end(), kBegin.begin(), kBegin.end());
    std::size_t at = static_cast<std::size_t>(found - data.begin()) + kSignature;
    const auto put = [&](std::size_t to, std::uint64_t value) {
      for (unsigned i = 0; i < 4; ++i) data[to + i] = static_cast<std::uint8_t>(value >> (24 - 8 * i));
    };
    while (at + kAround <= data.size()) {
      const std::size_t size = std::size_t{data[at]} << 24 | data[at + 1] << 16 | data[at + 2] << 8 | data[at + 3];
      if (size > data.size() - at - kAround) return;
      put(at + 8 + size, crc32(0, data.data() + at + 4, static_cast<uInt>(size + 4)));
      at += kAround + size;
    }
  }

  void repair_names(LooseMessage::Part& part, std::uint8_t way) {
    Bytes8& data = part.data;
    if (part.type == static_cast<std::uint8_t>(lidarcodec::SectionType::Range)) repair_png(data);
    if (part.type == static_cast<std::uint8_t>(lidarcodec::SectionType::Calibration) && data.size() >= 1 + kNameBytes) {
      if (data[0] == 2 && data.size() >= kTableHead + kTableBytes) {  // name and table as they are
        const std::size_t named = std::min<std::size_t>(data[kTableHead - 1], data.size() - kTableHead - kTableBytes);
        data[kTableHead - 1] = static_cast<std::uint8_t>(named);
        data.resize(kTableHead + named + kTableBytes);
        const auto table = data.begin() + static_cast<std::ptrdiff_t>(kTableHead + named);
        Bytes8 hashed(data.begin() + kTableHead, table);
        hashed.push_back(0);
        hashed.insert(hashed.end(), table, data.end());
        const auto hash = lidarcodec::sha256(hashed);
        std::copy_n(hash.begin(), kNameBytes, data.begin() + 1);
      }
      if (data[0] == 3) repair_described(data);
      if (data[0] == 0 && !calibration_.empty() && way % 8 != 7)
        std::copy_n(calibration_.begin() + 1, kNameBytes, data.begin() + 1);
      if (data[0] != 0) calibration_ = data;
    }
    if (part.type != static_cast<std::uint8_t>(lidarcodec::SectionType::Weights) || data.size() < 5 + kFuzzChecksum)
      return;
    const bool update = lidarcodec::is_update(data);
    if (update && !name_.empty() && data.size() >= 5 + 2 * kNameBytes + kFuzzChecksum)
      std::copy(name_.begin(), name_.end(), data.begin() + 5);
    put_little_endian(data, data.size() - kFuzzChecksum, lidarcodec::crc32c(data.data(), data.size() - kFuzzChecksum),
                      kFuzzChecksum);
    if (update) {
      if (data.size() >= 5 + 2 * kNameBytes + kFuzzChecksum)
        name_.assign(data.begin() + 5 + kNameBytes, data.begin() + 5 + 2 * kNameBytes);
    } else {
      const auto hash = lidarcodec::sha256(data);
      name_.assign(hash.begin(), hash.begin() + kNameBytes);
      weights_ = data;
    }
  }

  std::optional<std::uint64_t> last_;
  bool joins_late_ = false;
  Bytes8 calibration_, weights_, name_;
};

// Bytes changed by libFuzzer, at most so many more.
inline void mutate_bytes(Bytes8& data, std::size_t more) {
  const std::size_t size = data.size();
  data.resize(size + more);
  data.resize(LLVMFuzzerMutate(data.data(), size, data.size()));
}

// Changes one section, one header or the order of messages, and leaves all else whole. Returns the new size.
inline std::size_t mutated_messages(std::uint8_t* data, std::size_t size, std::size_t most, unsigned seed) {
  std::minstd_rand random(seed);
  const auto one_of = [&](std::size_t count) { return static_cast<std::size_t>(random() % count); };
  if (size == 0 || one_of(32) == 0) return LLVMFuzzerMutate(data, size, most);
  Bytes8 made(1, data[0]);
  std::vector<Bytes8> messages = messages_of({data + 1, data + size});
  if (messages.empty()) return LLVMFuzzerMutate(data, size, most);
  const std::size_t at = one_of(messages.size()), other = one_of(messages.size());
  const std::size_t kind = one_of(24);
  if (kind == 0) {
    made[0] = static_cast<std::uint8_t>(random());
  } else if (kind == 1) {
    messages.push_back(messages[at]);
  } else if (kind == 2) {
    messages.erase(messages.begin() + static_cast<std::ptrdiff_t>(at));
  } else if (kind == 3) {
    std::swap(messages[at], messages[other]);
  } else {
    LooseMessage message(messages[at]);
    const LooseMessage from(messages[other]);
    std::vector<LooseMessage::Part>& parts = message.parts;
    const std::size_t part = parts.empty() ? 0 : one_of(parts.size());
    if (kind < 6 || parts.empty())
      message.header[4 + one_of(kFuzzHeader - 4)] = static_cast<std::uint8_t>(random());
    else if (kind == 6 && !from.parts.empty())
      parts.push_back(from.parts[one_of(from.parts.size())]);
    else if (kind == 7)
      parts.erase(parts.begin() + static_cast<std::ptrdiff_t>(part));
    else if (kind == 8)
      parts[part].type = static_cast<std::uint8_t>(random() % 16);
    else
      mutate_bytes(parts[part].data, 64);
    messages[at] = message.joined();
  }
  for (const Bytes8& message : messages) {
    made.resize(made.size() + 4);
    put_little_endian(made, made.size() - 4, message.size(), 4);
    made.insert(made.end(), message.begin(), message.end());
  }
  made.resize(std::min(made.size(), most));
  std::copy(made.begin(), made.end(), data);
  return made.size();
}
