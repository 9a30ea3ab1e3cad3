#include "simulator/packets.hpp"

namespace lidarcodec::sim {
namespace {

// 117/700 degree a firing on average: a revolution of about 2154 firings and 103.4 ms.
constexpr std::int64_t kTurnPerFiring = (std::int64_t{11700} << 24) / 700;

void put16(std::uint8_t* p, std::uint32_t v) {
  p[0] = static_cast<std::uint8_t>(v);
  p[1] = static_cast<std::uint8_t>(v >> 8);
}

// Days since 1970-01-01 to a date of the Gregorian calendar; years are counted from March, in eras of 400.
void date_of(std::int64_t days, int& year, int& month, int& day) {
  const std::int64_t z = days + 719468;
  const std::int64_t era = z / 146097;
  const std::int64_t doe = z - era * 146097;
  const std::int64_t yoe = (doe - doe / 1460 + doe / 36524 - doe / 146096) / 365;
  const std::int64_t doy = doe - (365 * yoe + yoe / 4 - yoe / 100);
  const std::int64_t mp = (5 * doy + 2) / 153;
  day = static_cast<int>(doy - (153 * mp + 2) / 5 + 1);
  month = static_cast<int>(mp < 10 ? mp + 3 : mp - 9);
  year = static_cast<int>(yoe + era * 400 + (month <= 2 ? 1 : 0));
}

}  // namespace

Rotor::Rotor(std::uint64_t seed) : seed_(seed) {
  position_ = static_cast<std::int64_t>(unit_of(hash_of(seed, 91)) * 36000.0 * 16777216.0);
}

int Rotor::next() {
  const int azimuth = static_cast<int>((position_ >> 24) / 9) * 9;
  if (firing_ % 24 == 0) {  // the speed of the motor varies slowly
    const double t = static_cast<double>(firing_) * 48e-6;
    const double phase = unit_of(seed_);
    const double hunt = 0.0016 * sin_turns(t / 2.9 + phase) + 0.0009 * sin_turns(t / 0.83 + 2.0 * phase);
    step_ = kTurnPerFiring + static_cast<std::int64_t>(hunt * static_cast<double>(kTurnPerFiring));
  }
  position_ += step_;
  if (position_ >= (std::int64_t{36000} << 24)) position_ -= std::int64_t{36000} << 24;
  ++firing_;
  return azimuth;
}

Status::Status(std::int64_t start_ns, std::uint64_t seed) : start_ns_(start_ns), seed_(seed) {
  // HDL-64E user manual, appendix on the calibration bytes: a heading, 64 lasers of 4 rounds, 3 rounds of parameters.
  const std::uint8_t head[7] = {'U', 'N', 'I', 'T', '#', 24, 24};
  table_.assign(head, head + 7);
  const std::uint8_t made[7] = {11, 9, 14, 10, 32, 5, 38};  // calibrated 2011-09-14 10:32:05 at 38 % humidity
  for (int laser = 0; laser < kLasers; ++laser) {
    const LaserRow& row = kLaserTable[static_cast<std::size_t>(laser)];
    std::uint8_t bytes[28] = {};
    bytes[0] = static_cast<std::uint8_t>(laser);
    const std::int16_t values[9] = {row.vert_cdeg,      row.rot_cdeg,        row.dist_mm,  row.dist_mm,    row.dist_mm,
                                    row.vert_offset_mm, row.horiz_offset_mm, row.focal_mm, row.slope_tenth};
    for (int k = 0; k < 9; ++k) put16(bytes + 1 + 2 * k, static_cast<std::uint16_t>(values[k]));
    bytes[19] = kMinIntensity;
    bytes[20] = kMaxIntensity;
    if (laser == kLasers - 1)
      for (int k = 0; k < 7; ++k) bytes[21 + k] = made[k];
    table_.insert(table_.end(), bytes, bytes + 28);
  }
  std::uint8_t tail[21] = {};
  put16(tail, 580);  // revolutions a minute
  put16(tail + 2, 0);
  put16(tail + 4, 36000);  // field of view
  put16(tail + 6, 1289);   // hours of life
  const std::uint8_t from[4] = {192, 168, 3, 43}, to[4] = {192, 168, 3, 255};
  for (int k = 0; k < 4; ++k) tail[8 + k] = from[k], tail[12 + k] = to[k];
  tail[16] = 0;            // strongest return
  tail[17] = 0x60;         // warnings: none; PPS and GPS time present
  tail[18] = 0xA8;         // power level
  put16(tail + 19, 1820);  // the S2 ends with the size of the table where the S3 has a checksum
  table_.insert(table_.end(), tail, tail + 21);
}

void Status::write(std::uint64_t packet, std::uint8_t* tail) const {
  const std::int64_t ns = static_cast<std::int64_t>(packet) * kPacketNs;
  const std::int64_t now_us = (start_ns_ + ns) / 1000;
  const std::int64_t seconds = now_us / 1'000'000;
  const auto stamp = static_cast<std::uint32_t>(now_us % 3'600'000'000);
  for (int k = 0; k < 4; ++k) tail[k] = static_cast<std::uint8_t>(stamp >> (8 * k));
  const int turn = static_cast<int>(packet % 16);
  if (turn >= 9) {
    tail[4] = static_cast<std::uint8_t>('1' + turn - 9);
    tail[5] = table_[static_cast<std::size_t>(packet / 16 % 260) * 7 + static_cast<std::size_t>(turn - 9)];
    return;
  }
  const std::int64_t day_s = seconds % 86400;
  int year = 0, month = 0, day = 0;
  date_of(seconds / 86400, year, month, day);
  // The temperature rises in the first minutes, then varies.
  const double minutes = static_cast<double>(ns) / 60e9;
  const double heat = 27.0 + 14.0 * minutes / (minutes + 4.0) + 1.5 * sin_turns(minutes / 7.0 + unit_of(seed_));
  const int values[9] = {static_cast<int>(day_s / 3600),
                         static_cast<int>(day_s / 60 % 60),
                         static_cast<int>(day_s % 60),
                         day,
                         month,
                         year % 100,
                         'A',
                         static_cast<int>(heat),
                         72};
  tail[4] = static_cast<std::uint8_t>("HMSDNYGTV"[turn]);
  tail[5] = static_cast<std::uint8_t>(values[turn]);
}

void write_firing(std::uint8_t* packet, int firing, int azimuth, const std::array<Echo, kLasers>& echoes) {
  std::uint8_t* block = packet + firing * 200;
  for (int half = 0; half < 2; ++half, block += 100) {
    put16(block, half == 0 ? 0xEEFFu : 0xDDFFu);
    put16(block + 2, static_cast<std::uint32_t>(azimuth));
    for (int n = 0; n < 32; ++n) {
      const Echo& echo = echoes[static_cast<std::size_t>(32 * half + n)];
      put16(block + 4 + 3 * n, echo.range);
      block[4 + 3 * n + 2] = echo.intensity;
    }
  }
}

}  // namespace lidarcodec::sim
