// A history as a range image: its points, looked up by row and slot or by row and angle, in metres.
#pragma once
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <vector>

#include "motion/beams.hpp"
#include "motion/range_history.hpp"
#include "motion/vectors.hpp"

namespace lidarcodec {

// Which of seven slots that hold a return, a bit each, is nearest to the middle one, bit 3; of two as near, the later
// one.
class NearestSlot {
 public:
  static constexpr std::size_t kReach = 3;  // slots to each side
  static constexpr std::size_t kWindow = 2 * kReach + 1;

  constexpr NearestSlot() {
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
inline constexpr NearestSlot kNearestSlot;

class View {
 public:
  View(const RangeHistory& history, const BeamTable& table, const Beams& beams)
      : history_(history), table_(table), beams_(beams), azimuth_cs_(2 * kSlots), occupied_(kRows * kRowBytes) {
    std::vector<std::uint16_t> taken(2 * kSlots);
    for (std::size_t h = 0; h < 2; ++h) {
      for (std::size_t s = 0; s < kSlots; ++s) {
        const std::uint16_t azimuth = history.azimuths(h)[s];
        if (azimuth == kNoAzimuth) continue;
        taken[h * kSlots + s] = static_cast<std::uint16_t>(1u << s % 8);
        const bool as_upper = h == 1 && azimuth == history.azimuths(0)[s];
        azimuth_cs_[h * kSlots + s] = as_upper ? azimuth_cs_[s] : cos_sin(angle_of_azimuth(azimuth));
      }
    }
    for (std::size_t row = 0; row < kRows; ++row) mark(row, taken.data() + table.half[row] * kSlots);
  }

  // Which of the nine slots from this one on hold a return of a row, up to the last slot; the lowest bit is the slot
  // itself.
  std::uint32_t returns_from(std::size_t row, std::size_t slot) const {
    const std::uint8_t* bytes = occupied_.data() + row * kRowBytes + slot / 8;
    return (bytes[0] | static_cast<std::uint32_t>(bytes[1]) << 8) >> (slot % 8);
  }

  // The return in a slot of a row; there must be one.
  Vector3 at(std::size_t row, std::size_t slot) const {
    const Beam& beam = beams_[row];
    const Point p = beam.point(history_.ranges(row)[slot] * kLengthsPerStep + beam.distance_correction,
                               azimuth_cs_[table_.half[row] * kSlots + slot]);
    return {static_cast<double>(p.x) * kLengthM, static_cast<double>(p.y) * kLengthM,
            static_cast<double>(p.z) * kLengthM};
  }

  // Direction of a row's beam in a slot.
  Angle angle_of(std::size_t row, std::size_t slot) const {
    return static_cast<Angle>(slot << 20) - beams_[row].rotation;
  }

  // The slot in which a row's beam has a direction.
  std::size_t slot_of(std::size_t row, Angle angle) const {
    return static_cast<Angle>(angle + beams_[row].rotation) >> 20;
  }

  // The return of a row nearest to a slot, at most kReach away; false: there is none.
  bool nearest(std::size_t row, std::size_t slot, Vector3& point) const {
    const std::size_t first = (slot + kSlots - NearestSlot::kReach) % kSlots;
    const std::size_t nearest_slot = kNearestSlot[returns_from(row, first) % (1u << NearestSlot::kWindow)];
    if (nearest_slot == NearestSlot::kWindow) return false;
    point = at(row, (first + nearest_slot) % kSlots);
    return true;
  }
  bool nearest_by_angle(std::size_t row, Angle angle, Vector3& point) const {
    return nearest(row, slot_of(row, angle), point);
  }

 private:
  static constexpr std::size_t kRowBytes = kSlots / 8 + 1;  // the first byte again after the last one

  // Notes in which slots a row has returns. taken: 1 << slot % 8 for each slot in which its half has an azimuth, else
  // 0.
  void mark(std::size_t row, const std::uint16_t* taken) {
    const Beam& beam = beams_[row];
    if (!beam.usable) return;
    const std::uint16_t* ranges = history_.ranges(row);
    // Ranges up to this one are not positive when they are corrected.
    const auto none =
        static_cast<std::uint16_t>(std::max<std::int64_t>(-beam.distance_correction / kLengthsPerStep, 0));
    std::array<std::uint16_t, kSlots> marks;
    for (std::size_t s = 0; s < kSlots; ++s) marks[s] = static_cast<std::uint16_t>(taken[s] & -(ranges[s] > none));
    std::uint8_t* bytes = occupied_.data() + row * kRowBytes;
    for (std::size_t b = 0; b < kSlots / 8; ++b) {
      std::array<std::uint64_t, 2> four;  // eight marks; their order does not matter, as their bits differ
      std::memcpy(four.data(), marks.data() + 8 * b, sizeof four);
      const std::uint64_t two = (four[0] | four[1]) | (four[0] | four[1]) >> 32;
      bytes[b] = static_cast<std::uint8_t>(two | two >> 16);
    }
    bytes[kSlots / 8] = bytes[0];
  }

  const RangeHistory& history_;
  const BeamTable& table_;
  const Beams& beams_;
  std::vector<CosSin> azimuth_cs_;
  std::vector<std::uint8_t> occupied_;  // a bit for each slot of each row
};

}  // namespace lidarcodec
