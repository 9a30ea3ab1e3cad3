// Packets to images and back, byte for byte. The same rules in words: lidarcodec/side.py and docs/wire-format.md.
#pragma once
#include <array>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "base/rows.hpp"

namespace lidarcodec {

constexpr std::size_t kPacketBytes = 1206;
constexpr std::size_t kBlocks = 12;
constexpr std::size_t kBlockBytes = 100;
constexpr std::size_t kBlockLasers = 32;
constexpr std::size_t kBlockReturnBytes = kBlockLasers * 3;
constexpr std::size_t kRings = kRows;
constexpr std::size_t kMaxPackets = 2048;
constexpr std::uint16_t kUpperFlag = 0xEEFF;
constexpr std::uint16_t kLowerFlag = 0xDDFF;
constexpr std::uint16_t kAzimuthTurn = 36000;

enum class Role : std::uint8_t {
  Irregular = 0,
  UpperOpens = 1,
  UpperJoins = 2,
  LowerOpens = 3,
  LowerJoins = 4,
  UpperSecond = 5,
  LowerSecond = 6,
};
constexpr std::uint8_t kRoles = 7;
using Layout = std::array<std::uint8_t, kBlocks>;

// Ring (row) of each of the 64 hardware lasers.
using RingOfLaser = std::array<std::uint8_t, kRings>;

struct Assembled {
  std::size_t width = 0;
  std::vector<std::uint16_t> range;     // 64 x width
  std::vector<std::uint8_t> intensity;  // 64 x width
  std::vector<std::uint16_t> azimuth;   // 2 x width
  std::vector<std::uint8_t> fired;      // 2 x width
  std::vector<std::uint8_t> layouts;    // L x 12
  std::vector<std::uint16_t> layout;    // P
  std::vector<std::uint8_t> irregular;  // K x 100
  std::vector<std::uint8_t> second;     // S x 96
  std::vector<std::uint32_t> gps_us;    // P
  std::vector<std::uint8_t> status;     // P x 2
};

// Where each of the twelve blocks of a packet goes.
Layout layout_of(const std::uint8_t* packet);

// `bytes` must be a whole number of packets, at most kMaxPackets; throws Error(Packet) otherwise.
Assembled assemble(const std::uint8_t* payloads, std::size_t bytes, const RingOfLaser& ring_of_laser);

// Views of what `disassemble` reads; sizes in elements.
struct Images {
  std::size_t width;
  const std::uint16_t* range;
  const std::uint8_t* intensity;
  const std::uint16_t* azimuth;
  const std::uint8_t* fired;
  std::size_t packets;
  std::size_t layout_count;
  const std::uint8_t* layouts;
  const std::uint16_t* layout;
  std::size_t irregular_count;
  const std::uint8_t* irregular;
  std::size_t second_count;
  const std::uint8_t* second;
  const std::uint32_t* gps_us;
  const std::uint8_t* status;
};

// The payloads that `assemble` was given; throws Error(Section) when the parts do not fit each other.
std::vector<std::uint8_t> disassemble(const Images& in, const RingOfLaser& ring_of_laser);

}  // namespace lidarcodec
