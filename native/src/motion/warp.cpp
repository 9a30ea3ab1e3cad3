#include "motion/warp.hpp"

#include <algorithm>
#include <array>
#include <bit>
#include <bitset>
#include <memory>

#include "base/processor.hpp"
#include "motion/moved_row.hpp"
#include "motion/warp_crossing.hpp"

namespace lidarcodec {
namespace {

// The columns in which a half fired, and their azimuths as angles.
struct Fired {
  std::vector<std::uint32_t> column;
  std::vector<Angle> angle;

  Fired(const Columns& columns, std::size_t half) {
    const std::uint16_t* azimuth = columns.azimuth + half * columns.width;
    const std::uint8_t* fired = columns.fired + half * columns.width;
    for (std::size_t c = 0; c < columns.width; ++c) {
      if (!fired[c]) continue;
      column.push_back(static_cast<std::uint32_t>(c));
      angle.push_back(angle_of_azimuth(azimuth[c]));
    }
  }
};

// The sectors that hold a beam of the frame.
std::bitset<kSectors> needed_sectors(const std::array<Fired, 2>& fired, const BeamTable& table, const Beams& beams) {
  std::bitset<kSectors> sectors;
  std::array<std::bitset<kSectors>, 2> blocks;
  for (std::size_t h = 0; h < 2; ++h)
    for (const Angle angle : fired[h].angle) blocks[h].set(sector_of(angle));
  for (std::size_t row = 0; row < kRows; ++row) {
    const std::size_t rotated_by = sector_of(0u - beams[row].rotation);
    for (std::size_t s = 0; s < kSectors; ++s) {
      if (!blocks[table.half[row]][s]) continue;
      sectors.set((s + rotated_by) % kSectors);
      sectors.set((s + rotated_by + 1) % kSectors);
    }
  }
  return sectors;
}

std::bitset<kSectors> dilated(const std::bitset<kSectors>& sectors, std::size_t by) {
  std::bitset<kSectors> wide;
  for (std::size_t s = 0; s < kSectors; ++s)
    for (std::size_t d = 0; d <= 2 * by; ++d)
      if (sectors[s]) wide.set((s + kSectors + d - by) % kSectors);
  return wide;
}

// The sectors of azimuths at which a row may have seen one of the sources; a bit for each, as in `sources`.
std::uint64_t azimuths_of(std::uint64_t sources, const Beams& beams) {
  static_assert(kSectors == 64);
  std::uint64_t azimuths = 0;
  for (const Beam& beam : beams) azimuths |= std::rotl(sources, static_cast<int>(sector_of(beam.rotation)));
  return azimuths | std::rotl(azimuths, 1);
}

// Lasers sit to the left and to the right of the sensor's axis. The rows of a side share one surface.
struct LaserSide {
  std::vector<std::uint8_t> rows;
  std::int64_t mean_offset = 0;  // of their horizontal offsets

  LaserSide(const Beams& beams, bool left) {
    for (std::size_t row = 0; row < kRows; ++row) {
      if (!beams[row].usable || (beams[row].horizontal_offset < 0) != left) continue;
      rows.push_back(static_cast<std::uint8_t>(row));
      mean_offset += beams[row].horizontal_offset;
    }
    if (!rows.empty()) mean_offset = floor_divided(mean_offset, static_cast<std::int64_t>(rows.size()));
  }
};

// The fours of directions in which lengths of these rows are read, a 1 for each: those with a beam in them, or with the
// direction after a beam.
constexpr std::size_t kFours = kDirections / 4;
using FourFlags = std::array<std::uint8_t, kFours>;
FourFlags read_fours(const std::array<Fired, 2>& fired, const BeamTable& table, const Beams& beams,
                     const std::vector<std::uint8_t>& rows) {
  constexpr Angle kFourWidth = 4 * kDirectionWidth;
  std::array<FourFlags, 2> blocks{};
  for (std::size_t h = 0; h < 2; ++h)
    for (const Angle angle : fired[h].angle) blocks[h][angle / kFourWidth] = 1;
  FourFlags begins{}, fours{};  // begins: of each beam the four that it is in, or the one before
  for (const std::size_t row : rows) {
    const FourFlags& block = blocks[table.half[row]];
    const std::size_t turned = (0u - beams[row].rotation) / kFourWidth;
    for (std::size_t four = 0; four < kFours; ++four) begins[(four + turned) % kFours] |= block[four];
  }
  for (std::size_t four = 0; four < kFours; ++four)
    fours[four] = begins[four] | begins[(four + kFours - 1) % kFours] | begins[(four + kFours - 2) % kFours];
  return fours;
}

template <class Form>
[[gnu::always_inline]] inline std::vector<std::uint16_t> expect(const RangeHistory& history, const BeamTable& table,
                                                                const Motion& motion, const Columns& columns) {
  check_azimuths(columns);
  std::vector<std::uint16_t> expected(kRows * columns.width);
  const Beams beams = beams_of(table);
  const std::array<Fired, 2> fired = {Fired(columns, 0), Fired(columns, 1)};
  const std::bitset<kSectors> needed = needed_sectors(fired, table, beams);
  if (needed.none()) return expected;

  const std::array<LaserSide, 2> sides = {LaserSide(beams, false), LaserSide(beams, true)};
  const std::uint64_t sources = dilated(needed, 3).to_ullong(), azimuths = azimuths_of(sources, beams);
  const TakenSlots upper(history, 0, azimuths, nullptr), lower(history, 1, azimuths, &upper);
  // One allocation for both sides: the system takes smaller ones back when they are freed. Not cleared, which would
  // take time.
  const std::unique_ptr<Place[]> places(new Place[2 * Surface::kPlaces]);
  const std::unique_ptr<std::int32_t[]> lengths(new std::int32_t[2 * Surface::kPlaces]);
  std::array<Surface, 2> surfaces = {
      Surface(beams, sides[0].rows, places.get(), lengths.get()),
      Surface(beams, sides[1].rows, places.get() + Surface::kPlaces, lengths.get() + Surface::kPlaces)};
  MovedRow moved;
  for (std::size_t row = 0; row < kRows; ++row) {
    moved.move<Form>(history.ranges(row), table.half[row] ? lower : upper, beams[row], motion, sources);
    for (std::size_t side = 0; side < 2; ++side) {
      const bool own = (beams[row].horizontal_offset < 0) == (side == 1);
      if (!sides[side].rows.empty())
        moved.draw(own ? beams[row].horizontal_offset : sides[side].mean_offset, surfaces[side].ring(row));
    }
  }
  for (std::size_t side = 0; side < 2; ++side) {
    if (sides[side].rows.empty()) continue;
    const FourFlags fours = read_fours(fired, table, beams, sides[side].rows);
    for (std::size_t four = 0; four < kFours; ++four)
      if (fours[four] != 0) surfaces[side].template cross<Form>(4 * four);
    if (fours[0] != 0) surfaces[side].close();
    for (const std::size_t row : sides[side].rows) {
      const RowHits hits = surfaces[side].hits_of(row);
      const Fired& half = fired[table.half[row]];
      std::uint16_t* to = expected.data() + row * columns.width;
      for (std::size_t k = 0; k < half.angle.size(); ++k)
        to[half.column[k]] = hits.range(half.angle[k] - beams[row].rotation);
    }
  }
  return expected;
}

#if defined(__x86_64__)
LIDARCODEC_AVX2
[[gnu::flatten]] std::vector<std::uint16_t> expect_avx2(const RangeHistory& history, const BeamTable& table,
                                                        const Motion& motion, const Columns& columns) {
  return expect<FoursInOne>(history, table, motion, columns);
}
#endif

}  // namespace

std::vector<std::uint16_t> expected_ranges(const RangeHistory& history, const BeamTable& table, const Motion& motion,
                                           const Columns& columns) {
#if defined(__x86_64__)
  static const bool avx2 = quickest_path() == Path::Avx2;
  if (avx2) return expect_avx2(history, table, motion, columns);
#endif
  return expect<FoursInTwo>(history, table, motion, columns);
}

}  // namespace lidarcodec
