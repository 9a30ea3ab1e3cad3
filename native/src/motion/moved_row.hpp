// A row of the history after the motion: its points, and the polyline through them in each direction.
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

// The slots of a half that hold an azimuth in some sectors, with its cosine and sine.
struct TakenSlots {
  std::vector<std::uint16_t> slot;
  std::vector<Angle> angle;
  std::vector<CosSin> azimuth_cs;

  // sectors: a bit for each. other: the other half, which mostly fired at the same azimuths.
  TakenSlots(const RangeHistory& history, std::size_t half, std::uint64_t sectors, const TakenSlots* other) {
    const std::uint16_t* azimuths = history.azimuths(half);
    for (std::size_t s = 0; s < kSlots; ++s) {
      if (azimuths[s] == kNoAzimuth) continue;
      const Angle at = angle_of_azimuth(azimuths[s]);
      if ((sectors >> sector_of(at) & 1u) == 0) continue;
      slot.push_back(static_cast<std::uint16_t>(s));
      angle.push_back(at);
    }
    azimuth_cs.reserve(angle.size());
    const bool same = other != nullptr && other->angle.size() == angle.size();
    for (std::size_t k = 0; k < angle.size(); ++k)
      azimuth_cs.push_back(same && other->angle[k] == angle[k] ? other->azimuth_cs[k] : cos_sin(angle[k]));
  }
};

class MovedRow {
 public:
  // Moves the points of a row. sectors: a bit for each sector whose points are needed.
  template <class Form>
  [[gnu::always_inline]] void move(const std::uint16_t* ranges, const TakenSlots& taken, const Beam& beam,
                                   const Motion& motion, std::uint64_t sectors) {
    size_ = 0;
    if (!beam.usable) return;
    const std::size_t returns = gather(ranges, taken, beam, sectors);
    transform<Form>(returns, beam, motion);
    to_polar(x_.data(), y_.data(), angle_.data(), returns);
    drop_near(returns);
  }

  // Writes the row's polyline into a ring, as lasers with this horizontal offset see it.
  void draw(std::int64_t horizontal_offset, const RingPlaces& ring) {
    if (size_ == 0) return;
    add_parallax(horizontal_offset);
    Interpolated first;
    for (std::size_t from = 0; from < size_; from += kAtOnce) {
      const std::size_t n = std::min(kAtOnce, size_ - from);
      interpolate_first(from, n, first);
      for (std::size_t i = 0; i < n; ++i) {
        const std::size_t k = from + i;
        ring.put(direction_from(k), {first.away[i], first.height[i]});
        if (first.plain[i] != 0) [[likely]]
          continue;
        if (joined(k)) {
          interpolate_rest(k, ring);
        } else if (k != 0 && !joined(k - 1)) {
          draw_point(k, ring);
        }
      }
    }
    if (!joined(0) && !joined(size_ - 1)) draw_point(0, ring);
  }

 private:
  static constexpr std::size_t kAtOnce = 256;

  // For kAtOnce points, the place in the first direction between each and the next; kUnknown away if there is none.
  struct Interpolated {
    std::array<std::int32_t, kAtOnce> away, height,
        plain;  // plain: the points are joined, and no other direction is between them
  };

  // Collects the returns that are moved; gives their number.
  std::size_t gather(const std::uint16_t* ranges, const TakenSlots& taken, const Beam& beam, std::uint64_t sectors) {
    const std::uint16_t* slot = taken.slot.data();
    const Angle* angle = taken.angle.data();
    const CosSin* azimuth_cs = taken.azimuth_cs.data();
    std::int32_t *length = length_.data(), *cos = cos_.data(), *sin = sin_.data();
    const std::size_t slots = taken.slot.size();
    const Angle rotation = beam.rotation;
    const auto distance = static_cast<std::int32_t>(beam.distance_correction);
    std::size_t n = 0;
    for (std::size_t k = 0; k < slots; ++k) {
      const std::uint16_t range = ranges[slot[k]];
      const std::int32_t along = range * static_cast<std::int32_t>(kLengthsPerStep) + distance;
      length[n] = along;
      cos[n] = azimuth_cs[k].cos;
      sin[n] = azimuth_cs[k].sin;
      n += (range != 0) & (along > 0) & (sectors >> sector_of(angle[k] - rotation) & 1u);
    }
    return n;
  }

  // The points of the returns (as Beam::point) after the motion. A point too far away is put on the axis, so that
  // `drop_near` drops it. Doubles are exact here, because all sums of a rotation and a translation are whole numbers
  // below 2^53.
  template <class Form>
  [[gnu::always_inline]] void transform(std::size_t n, const Beam& beam, const Motion& motion) {
    const std::int32_t *length = length_.data(), *cos = cos_.data(), *sin = sin_.data();
    std::int32_t *x = x_.data(), *y = y_.data(), *z = z_.data();
    const auto number = [](std::int64_t a) { return static_cast<double>(a); };
    const double direction_x = number(beam.direction_x), direction_y = number(beam.direction_y),
                 direction_z = number(beam.direction_z);
    const double origin_x = number(beam.origin_x), origin_y = number(beam.origin_y), origin_z = number(beam.origin_z);
    std::array<double, 9> rotation;
    for (std::size_t i = 0; i < rotation.size(); ++i) rotation[i] = motion.rotation[i];
    const std::array<double, 3> shift = {number(motion.translation[0]), number(motion.translation[1]),
                                         number(motion.translation[2])};
    for (std::size_t k = 0; k < n; k += 4) {
      const Fours far = fours_of<Form>(load(length + k)), c = fours_of<Form>(load(cos + k)),
                  s = fours_of<Form>(load(sin + k));
      const Fours p = rounded30<Form>(far * direction_x) + origin_x, q = rounded30<Form>(far * direction_y) + origin_y;
      const Fours ahead = rounded30<Form>(p * c + q * s), left = rounded30<Form>(q * c - p * s),
                  high = rounded30<Form>(far * direction_z) + origin_z;
      const auto to = [&](std::size_t i) __attribute__((always_inline)) {
        return rounded30<Form>(rotation[3 * i] * ahead + rotation[3 * i + 1] * left + rotation[3 * i + 2] * high) +
               shift[i];
      };
      const Fours to_x = to(0), to_y = to(1), to_z = to(2);
      const FourMasks within = is_within(to_x) & is_within(to_y) & is_within(to_z);
      store(truncated(select(within, to_x * 16.0, Fours{})), x + k);
      store(truncated(select(within, to_y * -16.0, Fours{})), y + k);
      store(truncated(select(within, to_z, Fours{})), z + k);
    }
  }

  [[gnu::always_inline]] static FourMasks is_within(Fours at) { return absolute(at) <= double{kFarthest}; }

  // a / 2^30, rounded. Exact for whole numbers below 2^53.
  template <class Form>
  [[gnu::always_inline]] static Fours rounded30(Fours a) {
    return rounded_down<Form>(a * (1.0 / (1 << 30)) + 0.5);
  }

  // a if `so`, else b, without a branch.
  static std::int32_t either(bool so, std::int32_t a, std::int32_t b) {
    return b ^ ((a ^ b) & -static_cast<std::int32_t>(so));
  }

  // Puts the distance from the axis in place of x, and drops points that are too near.
  void drop_near(std::size_t n) {
    std::int32_t *away = x_.data(), *height = z_.data();
    Angle* angle = angle_.data();
    for (std::size_t k = 0; k < n; ++k) {  // unsigned, so that compilers use vectors
      const std::uint64_t along = static_cast<std::uint32_t>(away[k]);
      away[k] = static_cast<std::int32_t>(
          (along * static_cast<std::uint32_t>(kInverseCordicGain) + (std::uint64_t{1} << 33)) >> 34);
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

  // Corrects each angle by the parallax of a horizontal offset; the first point is repeated after the last one.
  void add_parallax(std::int64_t horizontal_offset) {
    // Exact: a double divides whole numbers of 32 bits and drops the fraction as an integer division does.
    const auto aside = static_cast<double>(floor_divided(horizontal_offset * kAnglePerRadian, 1 << 10));
    const std::int32_t* away = x_.data();
    const Angle* landed = angle_.data();
    Angle* seen = seen_.data();
    const std::size_t n = size_;
    for (std::size_t k = 0; k < n; ++k)
      seen[k] =
          landed[k] + static_cast<Angle>(static_cast<std::int32_t>(aside / static_cast<double>(away[k] >> 6))) * 16u;
    seen_[n] = seen_[0];
    x_[n] = x_[0];
    z_[n] = z_[0];
  }

  Place place(std::size_t k) const { return {x_[k], z_[k]}; }

  // Angle from a point to the next.
  Angle apart(std::size_t k) const { return seen_[k + 1] - seen_[k]; }
  static bool joins(Angle apart) { return (apart - 1) / kWidestGap == 0; }
  bool joined(std::size_t k) const { return joins(apart(k)); }

  // The first direction at or after a point, and the angle to it.
  std::uint32_t direction_from(std::size_t k) const { return (seen_[k] + (kDirectionWidth - 1)) / kDirectionWidth; }
  static std::int32_t to_direction(Angle seen) { return static_cast<std::int32_t>((0u - seen) % kDirectionWidth); }

  // a / 2^16, rounded. Exact, because a is a whole number of up to 2^40.
  static std::int32_t rounded16(double a) {
    constexpr std::int32_t up = 1 << 25;  // makes the number positive, so that dropping the fraction rounds down
    return static_cast<std::int32_t>(a * (1.0 / 65536) + (up + 0.5)) - up;
  }

  // The place at an angle `at` after a point, whose next point is `apart` away: interpolated, or across a jump in range
  // the place of the point that is nearer in angle.
  static Place between(const Place& a, const Place& b, std::int32_t at, std::int32_t apart) {
    const std::int32_t rise = b.away - a.away, climb = b.height - a.height;
    const bool jump = std::abs(rise) * static_cast<std::int32_t>(kJumpRatio) > (a.away < b.away ? a.away : b.away);
    const std::int32_t part =
        either(jump, either(2 * at < apart, 0, 65536), static_cast<std::int32_t>(at * 65536.0 / apart));
    return {a.away + rounded16(static_cast<double>(rise) * part),
            a.height + rounded16(static_cast<double>(climb) * part)};
  }

  // Interpolates in the first direction after each point; a loop that compilers vectorise.
  void interpolate_first(std::size_t from, std::size_t n, Interpolated& first) const {
    const std::int32_t *away = x_.data() + from, *height = z_.data() + from;
    const Angle* seen = seen_.data() + from;
    for (std::size_t k = 0; k < n; ++k) {
      const Angle apart = seen[k + 1] - seen[k];
      const auto width = static_cast<std::int32_t>(apart);
      const std::int32_t at = to_direction(seen[k]);
      const bool has = joins(apart) & (at <= width);
      const Place place = between({away[k], height[k]}, {away[k + 1], height[k + 1]}, at,
                                  either(has, width, static_cast<std::int32_t>(kWidestGap)));
      first.away[k] = either(has, place.away, kUnknown);
      first.height[k] = place.height;
      first.plain[k] = joins(apart) & (static_cast<std::int32_t>(apart - static_cast<Angle>(at)) <
                                       static_cast<std::int32_t>(kDirectionWidth));
    }
  }

  // Interpolates in the directions after the first.
  void interpolate_rest(std::size_t k, const RingPlaces& ring) const {
    const auto width = static_cast<std::int32_t>(apart(k));
    std::uint32_t direction = direction_from(k);
    for (std::int32_t at = to_direction(seen_[k]) + static_cast<std::int32_t>(kDirectionWidth); at <= width;
         at += kDirectionWidth)
      ring.put(++direction, between(place(k), place(k + 1), at, width));
  }

  void draw_point(std::size_t k, const RingPlaces& ring) const {
    ring.put((seen_[k] + kDirectionWidth / 2) / kDirectionWidth, place(k));
  }

  // Of the returns that were gathered.
  std::vector<std::int32_t> length_ = std::vector<std::int32_t>(kSlots + 4), cos_ = length_, sin_ = length_;
  // Of the points; after `drop_near`, x is the distance from the axis.
  std::vector<std::int32_t> x_ = length_, y_ = length_, z_ = length_;
  std::vector<Angle> angle_ = std::vector<Angle>(kSlots), seen_ = std::vector<Angle>(kSlots + 1);
  std::size_t size_ = 0;
};

}  // namespace lidarcodec
