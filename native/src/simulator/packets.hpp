// The rotation of the sensor, its time stamps and status bytes, and the 1206 bytes of its packets.
#pragma once
#include <array>
#include <vector>

#include "simulator/echo.hpp"
#include "simulator/sensor.hpp"

namespace lidarcodec::sim {

constexpr int kPacketBytes = 1206;
constexpr int kFiringsPerPacket = 6;
constexpr std::int64_t kPacketNs = 288'006;  // 288 us by the sensor's own quartz, 21 ppm slow
constexpr std::int64_t kFiringNs = kPacketNs / kFiringsPerPacket;

// The rotating head: its position at each firing, as the encoder reads it, in multiples of 0.09 degree.
class Rotor {
 public:
  explicit Rotor(std::uint64_t seed);
  int next();

 private:
  std::uint64_t seed_;
  std::uint64_t firing_ = 0;
  std::int64_t position_;  // 2^-24 of 0.01 degree
  std::int64_t step_ = 0;
};

// The status bytes: time of day, temperature, firmware, and the calibration table in 260 rounds of seven bytes.
class Status {
 public:
  // `start_ns`: GPS time at packet 0, ns since 1970.
  Status(std::int64_t start_ns, std::uint64_t seed);
  // Writes the tail of packet number `packet` (6 bytes).
  void write(std::uint64_t packet, std::uint8_t* tail) const;

 private:
  std::int64_t start_ns_;
  std::uint64_t seed_;
  std::vector<std::uint8_t> table_;
};

// Writes one firing, an upper and a lower block, at its place in a packet.
void write_firing(std::uint8_t* packet, int firing, int azimuth, const std::array<Echo, kLasers>& echoes);

}  // namespace lidarcodec::sim
