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
    // Pointers of its own: the compiler need not think that a point written moves the vectors.
    std::int32_t *x = x_.data(), *y = y_.data(), *z = z_.data();
    Angle* angle = angle_.data();
    const std::size_t slots = taken.slot.size();
    std::size_t n = 0;
    for (std::size_t k = 0; k < slots; ++k) {
      const std::uint16_t range = ranges[taken.slot[k]];
      if (range == 0 || !sectors[sector_of(taken.angle[k] - beam.rotation)]) continue;
      const std::int64_t length = range * kLengthsPerStep + beam.distance;
      if (length <= 0) continue;
      const Point at = motion.move(beam.point(length, taken.turn[k]));
      if (std::max({at.x, at.y, at.z}) > kFarthest || std::min({at.x, at.y, at.z}) < -kFarthest) continue;
      x[n] = static_cast<std::int32_t>(at.x * 16);
      y[n] = static_cast<std::int32_t>(at.y * -16);
      z[n++] = static_cast<std::int32_t>(at.z);
    }
    land(x, y, angle, n);
    std::size_t kept = 0;
    for (std::size_t k = 0; k < n; ++k) {
      const auto away = static_cast<std::int32_t>((x[k] * kShrink + (std::int64_t{1} << 33)) >> 34);
      if (away < kNearest) continue;
      x[kept] = away;
      z[kept] = z[k];
      angle[kept++] = angle[k];
    }
    size_ = kept;
  }

  // Lays the row out as beams see it that lie this far to the side of the axis.
  void lay(std::size_t row, std::int64_t sideways, Surface& surface) {
    const auto aside = static_cast<std::int32_t>(divided_down(sideways * kAngleOfRadian, 1 << 10));
    const std::int32_t *away = x_.data(), *height = z_.data();
    const Angle* landed = angle_.data();
    Angle* seen = seen_.data();
    const std::size_t n = size_;
    for (std::size_t k = 0; k < n; ++k) seen[k] = landed[k] + static_cast<Angle>(aside / (away[k] >> 6)) * 16u;

    const RingPlaces ring = surface.ring(row);
    bool before = false;  // whether point k is joined to the one before it
    bool first = false;   // and the first point to the last
    for (std::size_t k = 0; k < n; ++k) {
      const std::size_t next = k + 1 < n ? k + 1 : 0;
      const Angle apart = seen[next] - seen[k];
      const bool joined = apart != 0 && apart <= kWidestStretch;
      if (joined) {
        lay_stretch(seen[k], apart, {away[k], height[k]}, {away[next], height[next]}, ring);
        if (next == 0) first = true;
      } else if (!before && k != 0) {
        lay_point(seen[k], {away[k], height[k]}, ring);
      }
      if (k == 0) first = joined;
      before = joined;
    }
    if (n != 0 && !first) lay_point(seen[0], {away[0], height[0]}, ring);
  }

 private:
  static void lay_point(Angle angle, Place at, const RingPlaces& ring) {
    ring.put((angle + kDirection / 2) / kDirection, at);
  }

  // The directions between two points, or at one of them; across a jump the nearer point in angle.
  static void lay_stretch(Angle angle, Angle apart, Place from, Place to, const RingPlaces& ring) {
    std::uint32_t direction = angle / kDirection + (angle % kDirection != 0);
    std::uint64_t at = static_cast<Angle>(direction * kDirection - angle);
    if (at > apart) return;
    const std::int64_t rise = to.away - from.away, climb = to.height - from.height;
    const bool jump = std::abs(rise) * 16 > std::min(from.away, to.away);
    for (; at <= apart; at += kDirection) {
      if (jump) {
        ring.put(direction++, 2 * at < apart ? from : to);
      } else {
        const auto part = static_cast<std::int64_t>((at << 16) / apart);
        ring.put(direction++, {from.away + static_cast<std::int32_t>((rise * part + 32768) >> 16),
                               from.height + static_cast<std::int32_t>((climb * part + 32768) >> 16)});
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
  const Taken upper(history, 0, nullptr), lower(history, 1, &upper);
  const std::bitset<kSectors> sources = widened(looking.sectors, 3), seen = widened(looking.sectors, 1);
  // One piece of memory each for both sides: what is asked for and given back in small pieces, the system takes away.
  std::vector<Place> places(2 * Surface::kPlaces);
  std::vector<std::int32_t> met(2 * Surface::kPlaces);
  std::array<Surface, 2> surfaces = {
      Surface(beams, sides[0].rows, places.data(), met.data()),
      Surface(beams, sides[1].rows, places.data() + Surface::kPlaces, met.data() + Surface::kPlaces)};
  MovedRow moved;
  for (std::size_t row = 0; row < kRows; ++row) {
    moved.move(history.ranges(row), table.half[row] ? lower : upper, beams[row], motion, sources);
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
