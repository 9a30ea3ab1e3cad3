// Header and sections of a message (docs/wire-format.md, "Message"), in Python lidarcodec/wire.
#pragma once
#include <cstdint>
#include <optional>
#include <vector>

#include "base/bytes.hpp"

namespace lidarcodec {

enum class SectionType : std::uint8_t {
  Range = 1,
  Mask,
  Intensity,
  Azimuth,
  Side,
  Calibration,
  Keep,
  Motion,
  Weights,
  Pose,
  Filler,
  Lattice,
  Position,
  Planes,  // of other sensors than an HDL-64E
  Rest,
  Cloud  // a point cloud
};

// Numbers that name codecs in messages.
enum class Codec : std::uint16_t {
  Raw = 1,
  Zstd,
  Pcodec,
  Png,
  Jxl,
  Jpeg,
  JpegLayered,
  H264,
  H264Log,
  Riddle,
  Predictive
};

// "pcodec"; "" of a number that is no codec's.
const char* name_of(Codec codec);

struct Section {
  std::uint8_t type = 0, ordinal = 0;
  Bytes data;
};

// A message; sections are parts of the bytes that it was read from.
struct Message {
  Codec codec{};
  bool key = false;
  bool goes_on = false;  // a further part of the turn of the frame before, which it needs
  bool planes = false;   // of another sensor than an HDL-64E, in PLANES and REST sections
  std::uint64_t stream_id = 0, frame_index = 0;
  std::int64_t stamp_ns = 0;
  std::optional<std::uint64_t> needs;
  std::size_t frame_count = 0, width = 0, packets = 0;
  std::vector<Section> sections;

  bool has(SectionType type) const;
  // That of frame 0. Raises Section if there is none or two.
  Bytes section(SectionType type) const;
  // The same, or nothing if there is none. Raises Section if there are two.
  std::optional<Bytes> find(SectionType type) const {
    return has(type) ? std::optional<Bytes>(section(type)) : std::nullopt;
  }
  // Bytes of all sections together.
  std::size_t section_bytes() const;
};

inline constexpr std::size_t kMostColumns = 24'576;
inline constexpr std::size_t kMostMessage = 64u << 20;

// The message of exactly these bytes: size and checksum are checked before any field is believed. Raises Header,
// Version, Truncated, Checksum or Section.
Message read_message(Bytes data);

}  // namespace lidarcodec
