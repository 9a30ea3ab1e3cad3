// Points of a history by row and direction, in metres.
#pragma once
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <vector>

#include "motion/beams.hpp"
#include "motion/range_history.hpp"

namespace lidarcodec {

struct Metres {
  double x = 0, y = 0, z = 0;
};

inline Metres operator+(const Metres& a, const Metres& b) { return {a.x + b.x, a.y + b.y, a.z + b.z}; }
inline Metres operator-(const Metres& a, const Metres& b) { return {a.x - b.x, a.y - b.y, a.z - b.z}; }
inline Metres operator*(double k, const Metres& a) { return {k * a.x, k * a.y, k * a.z}; }
inline double dot(const Metres& a, const Metres& b) { return a.x * b.x + a.y * b.y + a.z * b.z; }
inline Metres cross(const Metres& a, const Metres& b) {
  return {a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}

inline constexpr double kLengthM = 0.0000625;  // 1/16 mm

// Of the slots around one that hold a return the closest. Bit 3 of a set of 7 is the slot itself; of two as close, the later one.
class Closest {
 public:
  static constexpr std::size_t kReach = 3;  // slots in which a return is looked for, to each side
  static constexpr std::size_t kWindow = 2 * kReach + 1;

  constexpr Closest() {
    constexpr std::array<std::uint8_t, kWindow> order = {3, 4, 2, 5, 1, 6, 0};
    for (std::size_t set = 1; set < of_.size(); ++set)
      for (const std::uint8_t at : order)
        if (of_[set] == kWindow && (set >> at & 1u) != 0) of_[set] = at;
  }

  constexpr std::size_t operator[](std::size_t set) const { return of_[set]; }

 private:
  std::array<std::uint8_t, std::size_t{1} << kWindow> of_ = [] {
    std::array<std::uint8_t, std::size_t{1} << kWindow> none{};
    none.fill(kWindow);
    return none;
  }();
};
inline constexpr Closest kClosest;

class View {
 public:
  View(const RangeHistory& history, const BeamTable& table, const Beams& beams)
      : history_(history), table_(table), beams_(beams), turn_(2 * kSlots), seen_(kRows * kRowBytes) {
    std::vector<std::uint16_t> taken(2 * kSlots);
    for (std::size_t h = 0; h < 2; ++h) {
      for (std::size_t s = 0; s < kSlots; ++s) {
        const std::uint16_t azimuth = history.azimuths(h)[s];
        if (azimuth == kNoAzimuth) continue;
        taken[h * kSlots + s] = static_cast<std::uint16_t>(1u << s % 8);
        const bool as_upper = h == 1 && azimuth == history.azimuths(0)[s];
        turn_[h * kSlots + s] = as_upper ? turn_[s] : turned(angle_of_azimuth(azimuth));
      }
    }
    for (std::size_t row = 0; row < kRows; ++row) look(row, taken.data() + table.half[row] * kSlots);
  }

  // Which of the slots from this one on, up to the last, hold a return of a row: the lowest bit is the slot itself. 9 of them.
  std::uint32_t returns_from(std::size_t row, std::size_t slot) const {
    const std::uint8_t* bytes = seen_.data() + row * kRowBytes + slot / 8;
    return (bytes[0] | static_cast<std::uint32_t>(bytes[1]) << 8) >> (slot % 8);
  }

  // The return in a slot of a row, which must be there.
  Metres at(std::size_t row, std::size_t slot) const {
    const Beam& beam = beams_[row];
    const Point p = beam.point(history_.ranges(row)[slot] * kLengthsPerStep + beam.distance, turn_[table_.half[row] * kSlots + slot]);
    return {static_cast<double>(p.x) * kLengthM, static_cast<double>(p.y) * kLengthM, static_cast<double>(p.z) * kLengthM};
  }

  // Angle in which the beam of a row looks from a slot.
  Angle looks(std::size_t row, std::size_t slot) const {
    return static_cast<Angle>(slot << 20) - beams_[row].rotation;
  }

  // The slot from which the beam of a row looks at an angle.
  std::size_t slot_of(std::size_t row, Angle angle) const { return static_cast<Angle>(angle + beams_[row].rotation) >> 20; }

  // The return of a row closest to a slot, at most 3 away; false: none.
  bool near(std::size_t row, std::size_t slot, Metres& point) const {
    const std::size_t first = (slot + kSlots - Closest::kReach) % kSlots;
    const std::size_t closest = kClosest[returns_from(row, first) % (1u << Closest::kWindow)];
    if (closest == Closest::kWindow) return false;
    point = at(row, (first + closest) % kSlots);
    return true;
  }
  bool near_angle(std::size_t row, Angle angle, Metres& point) const { return near(row, slot_of(row, angle), point); }

 private:
  static constexpr std::size_t kRowBytes = kSlots / 8 + 1;  // the first again after the last

  // Notes in which slots a row has returns. taken: 1 << slot % 8 for each that its half took, else 0
  void look(std::size_t row, const std::uint16_t* taken) {
    const Beam& beam = beams_[row];
    if (!beam.usable) return;
    const std::uint16_t* ranges = history_.ranges(row);
    // Without a length are those up to this range.
    const auto none = static_cast<std::uint16_t>(std::max<std::int64_t>(-beam.distance / kLengthsPerStep, 0));
    std::array<std::uint16_t, kSlots> marks;
    for (std::size_t s = 0; s < kSlots; ++s) marks[s] = static_cast<std::uint16_t>(taken[s] & -(ranges[s] > none));
    std::uint8_t* bytes = seen_.data() + row * kRowBytes;
    for (std::size_t b = 0; b < kSlots / 8; ++b) {
      std::array<std::uint64_t, 2> four;  // eight marks; which is where does not matter
      std::memcpy(four.data(), marks.data() + 8 * b, sizeof four);
      const std::uint64_t two = (four[0] | four[1]) | (four[0] | four[1]) >> 32;
      bytes[b] = static_cast<std::uint8_t>(two | two >> 16);
    }
    bytes[kSlots / 8] = bytes[0];
  }

  const RangeHistory& history_;
  const BeamTable& table_;
  const Beams& beams_;
  std::vector<Turned> turn_;
  std::vector<std::uint8_t> seen_;  // a bit for each slot of each row
};

}  // namespace lidarcodec
