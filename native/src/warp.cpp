#include "warp.hpp"

#include <algorithm>
#include <array>
#include <bitset>

#include "warp_surface.hpp"

namespace lidarcodec {
namespace {

// Columns of each half that fired, and in which sectors the beams of the rows then look.
struct Looking {
  std::bitset<kSectors> sectors;

  Looking(const Columns& columns, const BeamTable& table, const Beams& beams) {
    std::array<std::bitset<kSectors>, 2> blocks;
    for (std::size_t h = 0; h < 2; ++h)
      for (std::size_t c = 0; c < columns.width; ++c)
        if (columns.fired[h * columns.width + c])
          blocks[h].set(sector_of(angle_of_azimuth(columns.azimuth[h * columns.width + c])));
    for (std::size_t row = 0; row < kRows; ++row) {
      const std::size_t turned_by = sector_of(0u - beams[row].rotation);
      for (std::size_t s = 0; s < kSectors; ++s) {
        if (!blocks[table.half[row]][s]) continue;
        sectors.set((s + turned_by) % kSectors);
        sectors.set((s + turned_by + 1) % kSectors);
      }
    }
  }
};

std::bitset<kSectors> widened(const std::bitset<kSectors>& sectors, std::size_t by) {
  std::bitset<kSectors> wide;
  for (std::size_t s = 0; s < kSectors; ++s)
    for (std::size_t d = 0; d <= 2 * by; ++d)
      if (sectors[s]) wide.set((s + kSectors + d - by) % kSectors);
  return wide;
}

// Slots of a half that are taken, and cosine and sine of their azimuths.
struct Taken {
  std::vector<std::uint16_t> slot;
  std::vector<Angle> angle;
  std::vector<Turned> turn;

  Taken(const RangeHistory& history, std::size_t half) {
    const std::uint16_t* azimuths = history.azimuths(half);
    for (std::size_t s = 0; s < kSlots; ++s) {
      if (azimuths[s] == kNoAzimuth) continue;
      slot.push_back(static_cast<std::uint16_t>(s));
      angle.push_back(angle_of_azimuth(azimuths[s]));
    }
    turn.reserve(angle.size());
    for (const Angle a : angle) turn.push_back(turned(a));
  }
};

// Lasers sit on the left and on the right of the sensor. Those of one side are taken together.
struct Side {
  std::vector<std::uint8_t> rows;
  std::int64_t sideways = 0;  // their mean

  Side(const Beams& beams, bool left) {
    for (std::size_t row = 0; row < kRows; ++row) {
      if (!beams[row].usable || (beams[row].sideways < 0) != left) continue;
      rows.push_back(static_cast<std::uint8_t>(row));
      sideways += beams[row].sideways;
    }
    if (!rows.empty()) sideways = divided_down(sideways, static_cast<std::int64_t>(rows.size()));
  }
};

// A row of the history, moved: its points where the beam of the same row would now see them.
class MovedRow {
 public:
  MovedRow() : x_(kSlots), y_(kSlots), z_(kSlots), angle_(kSlots), seen_(kSlots) {}

  void move(const std::uint16_t* ranges, const Taken& taken, const Beam& beam, const Motion& motion,
            const std::bitset<kSectors>& sectors) {
    size_ = 0;
    if (!beam.usable) return;
    for (std::size_t k = 0; k < taken.slot.size(); ++k) {
      const std::uint16_t range = ranges[taken.slot[k]];
      if (range == 0 || !sectors[sector_of(taken.angle[k] - beam.rotation)]) continue;
      const std::int64_t length = range * kLengthsPerStep + beam.distance;
      if (length <= 0) continue;
      const Point at = motion.move(beam.point(length, taken.turn[k]));
      if (std::max({at.x, at.y, at.z}) > kFarthest || std::min({at.x, at.y, at.z}) < -kFarthest) continue;
      x_[size_] = static_cast<std::int32_t>(at.x * 16);
      y_[size_] = static_cast<std::int32_t>(at.y * -16);
      z_[size_++] = static_cast<std::int32_t>(at.z);
    }
    land(x_.data(), y_.data(), angle_.data(), size_);
    std::size_t kept = 0;
    for (std::size_t k = 0; k < size_; ++k) {
      const auto away = static_cast<std::int32_t>((x_[k] * kShrink + (std::int64_t{1} << 33)) >> 34);
      if (away < kNearest) continue;
      x_[kept] = away;
      z_[kept] = z_[k];
      angle_[kept++] = angle_[k];
    }
    size_ = kept;
  }

  // Lays the row out as beams see it that lie this far to the side of the axis.
  void lay(std::size_t row, std::int64_t sideways, Surface& surface) {
    const auto aside = static_cast<std::int32_t>(divided_down(sideways * kAngleOfRadian, 1 << 10));
    for (std::size_t k = 0; k < size_; ++k) seen_[k] = angle_[k] + static_cast<Angle>(aside / (x_[k] >> 6)) * 16u;
    bool alone = true;  // no stretch ends at point k
    bool first_met = false;
    for (std::size_t k = 0; k < size_; ++k) {
      const std::size_t next = k + 1 < size_ ? k + 1 : 0;
      const Angle apart = seen_[next] - seen_[k];
      const bool near = apart != 0 && apart <= kWidestStretch;
      if (near) {
        lay_stretch(k, next, apart, row, surface);
        if (next == 0) first_met = true;
      } else if (alone && k != 0) {
        lay_point(k, row, surface);
      }
      if (k == 0) first_met = first_met || near;
      alone = !near;
    }
    if (size_ != 0 && !first_met) lay_point(0, row, surface);
  }

 private:
  void lay_point(std::size_t k, std::size_t row, Surface& surface) const {
    surface.put((seen_[k] + kDirection / 2) / kDirection, row, x_[k], z_[k]);
  }

  // The directions between two points, or at one of them; across a jump the nearer point in angle.
  void lay_stretch(std::size_t from, std::size_t to, Angle apart, std::size_t row, Surface& surface) const {
    const std::int64_t rise = x_[to] - x_[from], climb = z_[to] - z_[from];
    const bool jump = std::abs(rise) * 16 > std::min(x_[from], x_[to]);
    std::uint32_t direction = seen_[from] / kDirection + (seen_[from] % kDirection != 0);
    for (std::uint64_t at = static_cast<Angle>(direction * kDirection - seen_[from]); at <= apart; at += kDirection) {
      if (jump) {
        const std::size_t k = 2 * at < apart ? from : to;
        surface.put(direction++, row, x_[k], z_[k]);
      } else {
        const auto part = static_cast<std::int64_t>((at << 16) / apart);
        surface.put(direction++, row, x_[from] + static_cast<std::int32_t>((rise * part + 32768) >> 16),
                    z_[from] + static_cast<std::int32_t>((climb * part + 32768) >> 16));
      }
    }
  }

  std::vector<std::int32_t> x_, y_, z_;  // then x_ is the distance from the axis
  std::vector<Angle> angle_, seen_;
  std::size_t size_ = 0;
};

}  // namespace

std::vector<std::uint16_t> expected_ranges(const RangeHistory& history, const BeamTable& table, const Motion& motion,
                                           const Columns& columns) {
  check_azimuths(columns);
  std::vector<std::uint16_t> expected(kRows * columns.width);
  const Beams beams = beams_of(table);
  const Looking looking(columns, table, beams);
  if (looking.sectors.none()) return expected;

  const std::array<Side, 2> sides = {Side(beams, false), Side(beams, true)};
  const std::array<Taken, 2> taken = {Taken(history, 0), Taken(history, 1)};
  const std::bitset<kSectors> sources = widened(looking.sectors, 3), seen = widened(looking.sectors, 1);
  std::array<Surface, 2> surfaces = {Surface(beams, sides[0].rows), Surface(beams, sides[1].rows)};
  MovedRow moved;
  for (std::size_t row = 0; row < kRows; ++row) {
    moved.move(history.ranges(row), taken[table.half[row]], beams[row], motion, sources);
    for (std::size_t side = 0; side < 2; ++side) {
      const bool own = (beams[row].sideways < 0) == (side == 1);
      if (!sides[side].rows.empty()) moved.lay(row, own ? beams[row].sideways : sides[side].sideways, surfaces[side]);
    }
  }
  for (std::size_t side = 0; side < 2; ++side) {
    for (std::size_t direction = 0; direction < kDirections; ++direction)
      if (seen[direction * kSectors / kDirections]) surfaces[side].cross(direction);
    for (const std::size_t row : sides[side].rows) {
      const std::size_t at = table.half[row] * columns.width;
      for (std::size_t c = 0; c < columns.width; ++c) {
        if (!columns.fired[at + c]) continue;
        const Angle angle = angle_of_azimuth(columns.azimuth[at + c]) - beams[row].rotation;
        expected[row * columns.width + c] = surfaces[side].range(angle, row);
      }
    }
  }
  return expected;
}

}  // namespace lidarcodec
