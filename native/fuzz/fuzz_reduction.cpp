// What reducers choose with: any frame, calibration, cells, poses and budgets. Whatever a sensor or an odometer says, a
// choice is made without harm, of returns that there are, each once, and as many as asked for.
#include <algorithm>
#include <cstdlib>
#include <vector>

#include "base/error.hpp"
#include "parts/fuzz_input.hpp"
#include "reduction/cell_pick.hpp"
#include "reduction/returns.hpp"
#include "reduction/seen_before.hpp"
#include "reduction/voxel_index.hpp"

using namespace lidarcodec;

namespace {

void check(bool holds) {
  if (!holds) std::abort();
}

// Whether places name each of `count` at most once.
bool once_each(std::vector<std::uint32_t> places, std::size_t count) {
  std::sort(places.begin(), places.end());
  return std::adjacent_find(places.begin(), places.end()) == places.end() && (places.empty() || places.back() < count);
}

void pick(const std::vector<std::int32_t>& xyz, const std::vector<std::uint32_t>& order, std::size_t want,
          std::int32_t side) {
  const std::size_t count = order.size();
  const Picked picked = pick_cells(xyz.data(), order.data(), count, want, side);
  check(picked.side >= kLeastSide && picked.side <= kMostSide);
  check(once_each(picked.places, count) && picked.places.size() <= std::max(count, want));
  if (want >= count) check(want == 0 || picked.places.size() == count);
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  FuzzInput input(data, size);
  const std::uint8_t kind = input.byte();
  const std::size_t width = input.below(64), want = input.below(4'000), step = input.below(36'000);
  Numbers numbers(input.rest());

  BeamTable table;
  for (std::size_t row = 0; row < kRows; ++row) {
    table.half[row] = kind & 1u ? row % 2 : row >= 32;
    const auto number = [&](int sane) { return kind & 2u ? static_cast<std::int32_t>(numbers.next(4)) : sane; };
    table.rotation[row] = number(static_cast<int>(row % 6) * 4'000'000);
    table.vertical[row] = number(4'000'000 - static_cast<int>(row) * 700'000);
    table.distance[row] = number(9'000'000);
    table.vertical_offset[row] = number(2'000'000);
    table.horizontal_offset[row] = number(row % 2 ? 260'000 : -260'000);
  }
  std::vector<std::uint16_t> azimuth(2 * width), ranges(kRows * width);
  const std::vector<std::uint8_t> fired(2 * width, 1);
  for (std::size_t c = 0; c < width; ++c) {
    azimuth[c] = static_cast<std::uint16_t>(c * step % (kind & 4u ? 40'000 : 36'000));  // beyond a turn is refused
    azimuth[width + c] = static_cast<std::uint16_t>((c * step + numbers.next(1)) % 36'000);
  }
  for (std::uint16_t& range : ranges)
    range = static_cast<std::uint16_t>(numbers.next(1) % 3 == 0 ? 0 : numbers.next(2));
  const Columns columns{width, azimuth.data(), fired.data()};

  try {
    const Returns returns = returns_of(ranges.data(), columns, table);
    const std::size_t count = returns.cell.size();
    const std::vector<std::uint32_t> order = lattice_of(returns.cell.data(), count, columns, table).order;
    check(order.size() == count && once_each(order, count));
    pick(returns.xyz, order, want, static_cast<std::int32_t>(numbers.next(4)));

    std::vector<float> moved(12 * width);
    for (std::size_t i = 0; i < moved.size(); ++i) moved[i] = kind & 8u ? numbers.any() : i % 12 % 5 == 0 ? 1.0f : 0.0f;
    const std::vector<float> points = deskewed(returns.xyz.data(), returns.cell.data(), count, moved.data(), width);
    const Scan scan{points.data(), count};
    const std::vector<std::uint8_t> ground = ground_of(scan, returns.cell.data(), columns, table);
    std::vector<PastScan> past(numbers.next(1) % 3);
    for (PastScan& one : past) {
      one.scan = scan;
      for (std::size_t i = 0; i < 12; ++i) one.placed[i] = kind & 16u ? numbers.any() : i % 5 == 0 ? 1.0f : 0.0f;
    }
    const std::vector<std::uint8_t> found = unseen(scan, ground.data(), past);
    check(ground.size() == count && found.size() == count);
    for (std::size_t i = 0; i < count; ++i) check(!(ground[i] && found[i]));
  } catch (const Error&) {
  }
  // Cells, orders and points that no frame has.
  std::vector<std::uint32_t> cells(numbers.next(1)), order(numbers.next(1));
  for (std::uint32_t& cell : cells) cell = numbers.next(2);
  if (kind & 32u) std::sort(cells.begin(), cells.end());
  std::vector<std::int32_t> xyz(3 * order.size());
  for (std::uint32_t& place : order) place = numbers.next(1);
  for (std::int32_t& at : xyz) at = static_cast<std::int32_t>(numbers.next(kind & 64u ? 4 : 2));
  try {
    check(once_each(lattice_of(cells.data(), cells.size(), columns, table).order, cells.size()));
  } catch (const Error&) {
  }
  try {
    std::vector<float> points(3 * cells.size());
    for (float& p : points) p = numbers.any();
    ground_of({points.data(), cells.size()}, cells.data(), columns, table);
  } catch (const Error&) {
  }
  try {
    pick_cells(xyz.data(), order.data(), order.size(), want, static_cast<std::int32_t>(numbers.next(4)));
  } catch (const Error&) {
  }
  try {
    std::vector<double> points(3 * (numbers.next(1) % 32));
    for (double& p : points) p = kind & 128u ? double{numbers.any()} : double(numbers.next(2)) / 100.0;
    const std::size_t count = points.size() / 3;
    const VoxelIndex index(points.data(), count, kind & 128u ? double{numbers.any()} : 0.5);
    std::vector<std::uint8_t> marks(count);
    std::vector<std::int32_t> nearest(count);
    const double reach = kind & 128u ? double{numbers.any()} : 1.0;
    index.mark_near(points.data(), count, reach, marks.data());
    index.nearest(points.data(), count, reach, nearest.data());
    for (const std::int32_t one : nearest) check(one >= -1 && one < static_cast<std::int32_t>(count));
  } catch (const Error&) {
  }
  return 0;
}
