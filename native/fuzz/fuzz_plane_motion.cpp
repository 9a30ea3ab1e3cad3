// Motion of planes: any bytes as directions of beams and columns, any motion of any ranges, the search for it between
// two scenes, and proportions of any numbers. The input's first bytes say kind and sizes.
#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <optional>

#include "base/error.hpp"
#include "images/proportion.hpp"
#include "parts/fuzz_input.hpp"
#include "plane_motion/finder.hpp"
#include "plane_motion/motion.hpp"
#include "plane_motion/moved.hpp"

using namespace lidarcodec;

namespace {

constexpr std::int32_t kMostMean = (1 << 23) - 1, kMostRange = (1 << 20) - 1;

// Beams that fall evenly, or as numbers say; within their limits.
PlaneBeams beams_of(Numbers& numbers, std::size_t rows, bool wild) {
  PlaneBeams beams;
  std::int32_t up = wild ? kMostUp : 60'000;
  for (std::size_t row = 0; row < rows; ++row) {
    beams.up.push_back(up);
    beams.aside.push_back(wild ? static_cast<std::int32_t>(numbers.next(3) % (2 * kMostAside + 1)) - kMostAside
                               : 2'000 * static_cast<std::int32_t>(row % 4));
    up -= wild ? kLeastBetweenRows + static_cast<std::int32_t>(numbers.next(2) % 9'000) : 6'000;
  }
  return beams;
}

// Azimuths of a turn, of a part of one, or any.
std::vector<std::uint16_t> azimuths_of(Numbers& numbers, std::size_t columns, std::uint8_t kind) {
  std::vector<std::uint16_t> azimuth;
  const std::uint32_t first = numbers.next(2), step = 1 + (kind % 3 == 0 ? 36'000 / (columns + 1) : numbers.next(1));
  for (std::uint32_t x = 0; x < columns; ++x)
    azimuth.push_back(static_cast<std::uint16_t>((kind % 3 == 2 ? numbers.next(2) : first + x * step) % 36'000));
  return azimuth;
}

void check_columns(const PlaneColumns& columns, std::size_t count) {
  if (columns.at.size() != count || columns.at[0] != 0 || columns.at.back() >= 2 * kWholeTurn || columns.step() == 0 ||
      !std::is_sorted(columns.at.begin(), columns.at.end()))
    std::abort();
}

// What is written comes back; any bytes are directions within the limits, or an error.
PlaneColumns check_directions(Numbers& numbers, const std::vector<std::uint8_t>& rest, std::size_t rows,
                              std::size_t count, std::uint8_t kind) {
  std::vector<std::uint8_t> out;
  const PlaneColumns columns = put_columns(out, azimuths_of(numbers, count, kind));
  if (columns.known()) {
    check_columns(columns, count);
    ByteReader reader({out.data(), out.size()}, "planes");
    const PlaneColumns back = take_columns(reader, count);
    if (back.at != columns.at || back.first != columns.first || reader.left() != 0) std::abort();
  }
  try {
    ByteReader reader({rest.data(), rest.size()}, "planes");
    check_columns(take_columns(reader, count), count);
    if (!beams_fit(take_beams(reader, rows), rows) || !take_motion(reader).within()) std::abort();
  } catch (const Error&) {
  }
  return columns;
}

PlaneMotion motion_of(Numbers& numbers, bool wild) {
  PlaneMotion motion;
  const auto within = [&](std::int32_t most) {
    return static_cast<std::int32_t>(numbers.next(4) % (2u * static_cast<std::uint32_t>(most) + 1)) - most;
  };
  for (std::int32_t& part : motion.turn) part = within(wild ? PlaneMotion::kMostTurn : 3'000);
  for (std::int32_t& part : motion.shift) part = within(wild ? PlaneMotion::kMostShift : 900);
  return motion;
}

// A room with a floor, or any ranges; in eighths of a range.
std::vector<std::int32_t> scene_of(Numbers& numbers, const PlaneBeams& beams, std::size_t columns, std::uint8_t kind,
                                   double ahead) {
  std::vector<std::int32_t> eighths;
  for (const std::int32_t up : beams.up)
    for (std::size_t x = 0; x < columns; ++x) {
      const double angle = 6.2831853 * static_cast<double>(x) / static_cast<double>(columns), tilt = up * 6.0e-6;
      const double wall = std::min(900.0 / (std::abs(std::cos(angle)) + 1e-3) + ahead * std::cos(angle),
                                   500.0 / (std::abs(std::sin(angle)) + 1e-3));
      const double floor = tilt < -0.01 ? 170.0 / -tilt : 1e9;
      const auto room = static_cast<std::int32_t>(8 * std::min(wall, floor));
      const auto any = static_cast<std::int32_t>(numbers.next(3) & kMostMean);
      eighths.push_back((kind & 1u) != 0 ? any : std::min(room + any % 9, kMostMean));
      if (numbers.next(1) % 16 == 0) eighths.back() = (kind & 2u) != 0 ? kMostMean : 0;
    }
  return eighths;
}

void check_moved(const MovedPlane& moved, std::size_t cells, std::size_t before, std::int32_t most) {
  if (moved.source.size() != cells || moved.mean.size() != cells) std::abort();
  for (std::size_t i = 0; i < cells; ++i)
    if (moved.source[i] < -1 || moved.source[i] >= static_cast<std::int32_t>(before) || moved.mean[i] < 0 ||
        moved.mean[i] > most)
      std::abort();
}

// Numbers of any kind; what is expected stays within the plane.
void check_proportion(Numbers& numbers, std::uint8_t kind) {
  Proportion proportion;
  const std::int32_t most = (1 << (1 + kind % 20)) - 1;
  for (int i = 0; i < 600; ++i) {
    const auto mate = static_cast<std::int32_t>(numbers.next(1 + kind / 32 % 3) & kMostRange);
    const auto range = static_cast<std::int32_t>(numbers.next(1 + kind / 64 % 3) & kMostRange);
    const std::int32_t told = proportion.of(mate, range, most);
    if (told < 0 || told > most) std::abort();
    proportion.learn(static_cast<std::int32_t>(numbers.next(3)) & most, mate);
    if (i % 50 == 0) proportion.next_row();
  }
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  FuzzInput input(data, size);
  const std::uint8_t kind = input.byte(), directions = input.byte();
  const std::size_t rows = 2 + input.byte() % 17, columns = 2 + input.byte() % 180, before = 2 + input.byte() % 180;
  const std::vector<std::uint8_t> rest = input.rest();
  Numbers numbers(rest);
  const bool wild = (kind & 4u) != 0;
  const PlaneBeams beams = beams_of(numbers, rows, wild);
  if ((kind & 128u) != 0) check_proportion(numbers, directions);
  const PlaneColumns now = check_directions(numbers, rest, rows, columns, directions);
  const PlaneColumns then = check_directions(numbers, rest, rows, before, directions / 3);
  if (!beams_fit(beams, rows) || !now.known() || !then.known()) return 0;
  const std::vector<std::int32_t> old = scene_of(numbers, beams, before, kind, 0);
  std::optional<PlaneMotion> motion = motion_of(numbers, (kind & 8u) != 0);
  if ((kind & 16u) != 0) {
    const std::vector<std::int32_t> fresh = scene_of(numbers, beams, columns, kind, (kind & 32u) != 0 ? 40 : 0);
    if ((kind & 64u) != 0) motion.reset();
    motion = find_motion(beams, {old, then}, {fresh, now}, 8 * 100.0, motion);
    if (motion && !motion->within()) std::abort();
  }
  if (!motion) return 0;
  const std::int32_t most = (8 << 20) - 8;
  check_moved(PlaneMover(beams, then, now).move(old, *motion, most), rows * columns, rows * before, most);
  return 0;
}
