// A row of the history, moved: its points where the beam of the same row would now see them.
#pragma once
#include <algorithm>
#include <array>
#include <cstdint>
#include <cstdlib>
#include <vector>

#include "motion/beams.hpp"
#include "motion/range_history.hpp"
#include "motion/warp_fours.hpp"
#include "motion/warp_surface.hpp"

namespace lidarcodec {

// Slots of a half that are taken, and cosine and sine of their azimuths.
struct Taken {
  std::vector<std::uint16_t> slot;
  std::vector<Angle> angle;
  std::vector<Turned> turn;

  // other: the half taken before, which mostly fired at the same azimuths.
  Taken(const RangeHistory& history, std::size_t half, const Taken* other) {
    const std::uint16_t* azimuths = history.azimuths(half);
    for (std::size_t s = 0; s < kSlots; ++s) {
      if (azimuths[s] == kNoAzimuth) continue;
      slot.push_back(static_cast<std::uint16_t>(s));
      angle.push_back(angle_of_azimuth(azimuths[s]));
    }
    turn.reserve(angle.size());
    const bool same = other != nullptr && other->angle.size() == angle.size();
    for (std::size_t k = 0; k < angle.size(); ++k)
      turn.push_back(same && other->angle[k] == angle[k] ? other->turn[k] : turned(angle[k]));
  }
};

class MovedRow {
 public:
  // sectors: a bit for each in which points are looked at
  template <class Form>
  [[gnu::always_inline]] void move(const std::uint16_t* ranges, const Taken& taken, const Beam& beam, const Motion& motion, std::uint64_t sectors) {
    size_ = 0;
    if (!beam.usable) return;
    const std::size_t returns = pick(ranges, taken, beam, sectors);
    carry<Form>(returns, beam, motion);
    land(x_.data(), y_.data(), angle_.data(), returns);
    keep(returns);
  }

  // Lays the row out as beams see it that lie this far to the side of the axis.
  void lay(std::int64_t sideways, const RingPlaces& ring) {
    if (size_ == 0) return;
    see(sideways);
    Laid laid;
    for (std::size_t from = 0; from < size_; from += kAtOnce) {
      const std::size_t n = std::min(kAtOnce, size_ - from);
      lay_first(from, n, laid);
      for (std::size_t i = 0; i < n; ++i) {
        const std::size_t k = from + i;
        ring.put(direction_from(k), {laid.away[i], laid.height[i]});
        if (laid.plain[i] != 0) [[likely]] continue;
        if (joined(k)) {
          lay_rest(k, ring);
        } else if (k != 0 && !joined(k - 1)) {
          lay_point(k, ring);
        }
      }
    }
    if (!joined(0) && !joined(size_ - 1)) lay_point(0, ring);
  }

 private:
  static constexpr std::size_t kAtOnce = 256;

  // Of so many points the place in the first direction from each to the next, kUnknown away if there is none.
  struct Laid {
    std::array<std::int32_t, kAtOnce> away, height, plain;  // plain: the point is joined, and there are no further directions
  };

  // The returns to be moved; how many.
  std::size_t pick(const std::uint16_t* ranges, const Taken& taken, const Beam& beam, std::uint64_t sectors) {
    const std::uint16_t* slot = taken.slot.data();
    const Angle* angle = taken.angle.data();
    const Turned* turn = taken.turn.data();
    std::int32_t *length = length_.data(), *cos = cos_.data(), *sin = sin_.data();
    const std::size_t slots = taken.slot.size();
    const Angle rotation = beam.rotation;
    const auto distance = static_cast<std::int32_t>(beam.distance);
    std::size_t n = 0;
    for (std::size_t k = 0; k < slots; ++k) {
      const std::uint16_t range = ranges[slot[k]];
      const std::int32_t along = range * static_cast<std::int32_t>(kLengthsPerStep) + distance;
      length[n] = along;
      cos[n] = turn[k].cos;
      sin[n] = turn[k].sin;
      n += (range != 0) & (along > 0) & (sectors >> sector_of(angle[k] - rotation) & 1u);
    }
    return n;
  }

  // The points of the returns (as Beam::point), moved. One too far away comes to lie on the axis, which is too near. In doubles,
  // which are exact where the motion is a rotation and a shift: what is added up is below 2^53.
  template <class Form>
  [[gnu::always_inline]] void carry(std::size_t n, const Beam& beam, const Motion& motion) {
    const std::int32_t *length = length_.data(), *cos = cos_.data(), *sin = sin_.data();
    std::int32_t *x = x_.data(), *y = y_.data(), *z = z_.data();
    const auto number = [](std::int64_t a) { return static_cast<double>(a); };
    const double along = number(beam.along), across = number(beam.across), up = number(beam.up);
    const double along_0 = number(beam.along_0), across_0 = number(beam.across_0), up_0 = number(beam.up_0);
    std::array<double, 9> turn;
    for (std::size_t i = 0; i < turn.size(); ++i) turn[i] = motion.rotation[i];
    const std::array<double, 3> shift = {number(motion.translation[0]), number(motion.translation[1]), number(motion.translation[2])};
    for (std::size_t k = 0; k < n; k += 4) {
      const Fours far = fours_of<Form>(ints_at(length + k)), c = fours_of<Form>(ints_at(cos + k)), s = fours_of<Form>(ints_at(sin + k));
      const Fours p = rounded30<Form>(far * along) + along_0, q = rounded30<Form>(far * across) + across_0;
      const Fours ahead = rounded30<Form>(p * c + q * s), left = rounded30<Form>(q * c - p * s), high = rounded30<Form>(far * up) + up_0;
      const auto to = [&](std::size_t i) __attribute__((always_inline)) {
        return rounded30<Form>(turn[3 * i] * ahead + turn[3 * i + 1] * left + turn[3 * i + 2] * high) + shift[i];
      };
      const Fours to_x = to(0), to_y = to(1), to_z = to(2);
      const FourMasks within = is_within(to_x) & is_within(to_y) & is_within(to_z);
      put(cut_off(chosen(within, to_x * 16.0, Fours{})), x + k);
      put(cut_off(chosen(within, to_y * -16.0, Fours{})), y + k);
      put(cut_off(chosen(within, to_z, Fours{})), z + k);
    }
  }

  [[gnu::always_inline]] static FourMasks is_within(Fours at) { return size_of(at) <= double{kFarthest}; }

  // a / 2^30, rounded. Exact for whole numbers below 2^53.
  template <class Form>
  [[gnu::always_inline]] static Fours rounded30(Fours a) {
    return rounded_down<Form>(a * (1.0 / (1 << 30)) + 0.5);
  }

  // a if so, else b; without a branch.
  static std::int32_t either(bool so, std::int32_t a, std::int32_t b) { return b ^ ((a ^ b) & -static_cast<std::int32_t>(so)); }

  // The points that are not too near the axis, with their distance from it in place of x.
  void keep(std::size_t n) {
    std::int32_t *away = x_.data(), *height = z_.data();
    Angle* angle = angle_.data();
    for (std::size_t k = 0; k < n; ++k) {  // without signs, of which compilers make vector code
      const std::uint64_t along = static_cast<std::uint32_t>(away[k]);
      away[k] = static_cast<std::int32_t>((along * static_cast<std::uint32_t>(kShrink) + (std::uint64_t{1} << 33)) >> 34);
    }
    std::size_t kept = 0;
    for (std::size_t k = 0; k < n; ++k) {
      const std::int32_t at = away[k];
      away[kept] = at;
      height[kept] = height[k];
      angle[kept] = angle[k];
      kept += at >= kNearest;
    }
    size_ = kept;
  }

  // The angles in which the points are seen; the first point stands after the last one too.
  void see(std::int64_t sideways) {
    // Exact: whole numbers of 32 bits divide and cut off as these do.
    const auto aside = static_cast<double>(divided_down(sideways * kAngleOfRadian, 1 << 10));
    const std::int32_t* away = x_.data();
    const Angle* landed = angle_.data();
    Angle* seen = seen_.data();
    const std::size_t n = size_;
    for (std::size_t k = 0; k < n; ++k)
      seen[k] = landed[k] + static_cast<Angle>(static_cast<std::int32_t>(aside / static_cast<double>(away[k] >> 6))) * 16u;
    seen_[n] = seen_[0];
    x_[n] = x_[0];
    z_[n] = z_[0];
  }

  Place place(std::size_t k) const { return {x_[k], z_[k]}; }

  // Angle from a point to the next.
  Angle apart(std::size_t k) const { return seen_[k + 1] - seen_[k]; }
  static bool joins(Angle apart) { return (apart - 1) / kWidestStretch == 0; }
  bool joined(std::size_t k) const { return joins(apart(k)); }

  // The first direction from a point on, and how far it is.
  std::uint32_t direction_from(std::size_t k) const { return (seen_[k] + (kDirection - 1)) / kDirection; }
  static std::int32_t to_direction(Angle seen) { return static_cast<std::int32_t>((0u - seen) % kDirection); }

  // a / 2^16, rounded. Exact, as a is a whole number of up to 2^40.
  static std::int32_t rounded16(double a) {
    constexpr std::int32_t up = 1 << 25;  // what is cut off is above 0
    return static_cast<std::int32_t>(a * (1.0 / 65536) + (up + 0.5)) - up;
  }

  // The place `at` after a point that is `apart` from the next; across a jump that of the nearer point in angle.
  static Place between(const Place& a, const Place& b, std::int32_t at, std::int32_t apart) {
    const std::int32_t rise = b.away - a.away, climb = b.height - a.height;
    const bool jump = std::abs(rise) * 16 > (a.away < b.away ? a.away : b.away);
    const std::int32_t part = either(jump, either(2 * at < apart, 0, 65536), static_cast<std::int32_t>(at * 65536.0 / apart));
    return {a.away + rounded16(static_cast<double>(rise) * part), a.height + rounded16(static_cast<double>(climb) * part)};
  }

  // A loop that compilers make vector code of.
  void lay_first(std::size_t from, std::size_t n, Laid& laid) const {
    const std::int32_t *away = x_.data() + from, *height = z_.data() + from;
    const Angle* seen = seen_.data() + from;
    for (std::size_t k = 0; k < n; ++k) {
      const Angle apart = seen[k + 1] - seen[k];
      const auto width = static_cast<std::int32_t>(apart);
      const std::int32_t at = to_direction(seen[k]);
      const bool has = joins(apart) & (at <= width);
      const Place place = between({away[k], height[k]}, {away[k + 1], height[k + 1]}, at,
                                  either(has, width, static_cast<std::int32_t>(kWidestStretch)));
      laid.away[k] = either(has, place.away, kUnknown);
      laid.height[k] = place.height;
      laid.plain[k] = joins(apart) & (static_cast<std::int32_t>(apart - static_cast<Angle>(at)) < static_cast<std::int32_t>(kDirection));
    }
  }

  // The directions after the first.
  void lay_rest(std::size_t k, const RingPlaces& ring) const {
    const auto width = static_cast<std::int32_t>(apart(k));
    std::uint32_t direction = direction_from(k);
    for (std::int32_t at = to_direction(seen_[k]) + static_cast<std::int32_t>(kDirection); at <= width; at += kDirection)
      ring.put(++direction, between(place(k), place(k + 1), at, width));
  }

  void lay_point(std::size_t k, const RingPlaces& ring) const {
    ring.put((seen_[k] + kDirection / 2) / kDirection, place(k));
  }

  // Of the returns that were picked.
  std::vector<std::int32_t> length_ = std::vector<std::int32_t>(kSlots + 4), cos_ = length_, sin_ = length_;
  // Of the points. After `keep` x is the distance from the axis.
  std::vector<std::int32_t> x_ = length_, y_ = length_, z_ = length_;
  std::vector<Angle> angle_ = std::vector<Angle>(kSlots), seen_ = std::vector<Angle>(kSlots + 1);
  std::size_t size_ = 0;
};

}  // namespace lidarcodec
