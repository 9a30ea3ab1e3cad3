// Points of a history by row and direction, in metres.
#pragma once
#include <array>
#include <cmath>
#include <cstdint>
#include <vector>

#include "beams.hpp"
#include "range_history.hpp"

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

class View {
 public:
  View(const RangeHistory& history, const BeamTable& table, const Beams& beams)
      : history_(history), table_(table), beams_(beams), turn_(2 * kSlots) {
    for (std::size_t h = 0; h < 2; ++h)
      for (std::size_t s = 0; s < kSlots; ++s)
        if (history.azimuths(h)[s] != kNoAzimuth) turn_[h * kSlots + s] = turned(angle_of_azimuth(history.azimuths(h)[s]));
  }

  // The return in a slot of a row; false: none.
  bool at(std::size_t row, std::size_t slot, Metres& point) const {
    const std::size_t h = table_.half[row];
    if (history_.azimuths(h)[slot] == kNoAzimuth) return false;
    const std::int64_t range = history_.ranges(row)[slot];
    const std::int64_t length = range * kLengthsPerStep + beams_[row].distance;
    if (range == 0 || length <= 0 || !beams_[row].usable) return false;
    const Point p = beams_[row].point(length, turn_[h * kSlots + slot]);
    point = {static_cast<double>(p.x) * kLengthM, static_cast<double>(p.y) * kLengthM,
             static_cast<double>(p.z) * kLengthM};
    return true;
  }

  // Angle in which the beam of a row looks from a slot.
  Angle looks(std::size_t row, std::size_t slot) const {
    return static_cast<Angle>(slot << 20) - beams_[row].rotation;
  }

  // The return of a row closest to an angle, at most `reach` slots away.
  bool near(std::size_t row, Angle angle, std::size_t reach, Metres& point) const {
    const std::size_t slot = static_cast<Angle>(angle + beams_[row].rotation) >> 20;
    for (std::size_t d = 0; d <= reach; ++d) {
      if (at(row, (slot + d) % kSlots, point)) return true;
      if (d != 0 && at(row, (slot + kSlots - d) % kSlots, point)) return true;
    }
    return false;
  }

 private:
  const RangeHistory& history_;
  const BeamTable& table_;
  const Beams& beams_;
  std::vector<Turned> turn_;
};

}  // namespace lidarcodec
