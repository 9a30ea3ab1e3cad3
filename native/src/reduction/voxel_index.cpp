#include "reduction/voxel_index.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

#include "base/error.hpp"

namespace lidarcodec {

namespace {

constexpr int kBits = 21;
constexpr std::int64_t kMiddle = std::int64_t{1} << (kBits - 1);
constexpr std::int64_t kMostReach = 8;  // cells

std::uint64_t key_of(const std::array<std::int64_t, 3>& place) {
  return static_cast<std::uint64_t>(place[0]) << (2 * kBits) | static_cast<std::uint64_t>(place[1]) << kBits |
         static_cast<std::uint64_t>(place[2]);
}

// Spreads keys, so that adjacent cells get distant slots: Knuth's multiplicative hash, between two xor-shifts.
std::uint64_t mixed(std::uint64_t key) {
  key ^= key >> 31;
  key *= 0x9E3779B97F4A7C15ull;  // 2^64 divided by the golden ratio
  return key ^ (key >> 29);
}

double squared_distance(const double* a, const double* b) {
  const double x = a[0] - b[0], y = a[1] - b[1], z = a[2] - b[2];
  return x * x + y * y + z * z;
}

}  // namespace

VoxelIndex::VoxelIndex(const double* points, std::size_t count, double cell_m) : cell_m_(cell_m) {
  if (!(cell_m >= 1e-3 && cell_m <= 100.0)) throw Error(ErrorCode::Settings, "a cell is from 1 mm to 100 m wide");
  if (count > std::size_t{1} << 31) throw Error(ErrorCode::Settings, "more than 2^31 points");
  std::vector<std::pair<std::uint64_t, std::uint32_t>> keyed(count);
  for (std::size_t i = 0; i < count; ++i) {
    Place place;
    if (!place_of(points + 3 * i, place))
      throw Error(ErrorCode::Settings, "a point that is not finite, or too far away");
    keyed[i] = {key_of(place), static_cast<std::uint32_t>(i)};
  }
  std::sort(keyed.begin(), keyed.end());
  std::size_t occupied = 0;
  for (std::size_t i = 0; i < count; ++i) occupied += i == 0 || keyed[i].first != keyed[i - 1].first;
  slots_ = 4;
  while (slots_ < 2 * occupied) slots_ *= 2;
  cells_.assign(slots_, Cell{0, 0, 0});
  order_.resize(count);
  points_.resize(3 * count);
  for (std::size_t i = 0; i < count;) {
    std::size_t end = i;
    for (; end < count && keyed[end].first == keyed[i].first; ++end) {
      order_[end] = keyed[end].second;
      std::copy_n(points + 3 * std::size_t{keyed[end].second}, 3, points_.begin() + 3 * end);
    }
    std::uint64_t slot = mixed(keyed[i].first) & (slots_ - 1);
    while (cells_[slot].begin != cells_[slot].end) slot = (slot + 1) & (slots_ - 1);
    cells_[slot] = {keyed[i].first, static_cast<std::uint32_t>(i), static_cast<std::uint32_t>(end)};
    i = end;
  }
}

bool VoxelIndex::place_of(const double* point, Place& place) const {
  for (int axis = 0; axis < 3; ++axis) {
    const double cell = std::floor(point[axis] / cell_m_);
    if (!(std::fabs(cell) < static_cast<double>(kMiddle - kMostReach - 1))) return false;  // also catches NaN
    place[axis] = static_cast<std::int64_t>(cell) + kMiddle;
  }
  return true;
}

const VoxelIndex::Cell* VoxelIndex::find(const Place& place) const {
  const std::uint64_t key = key_of(place);
  for (std::uint64_t slot = mixed(key) & (slots_ - 1);; slot = (slot + 1) & (slots_ - 1)) {
    const Cell& cell = cells_[slot];
    if (cell.begin == cell.end) return nullptr;
    if (cell.key == key) return &cell;
  }
}

void VoxelIndex::check_reach(double reach_m) const {
  if (!(reach_m >= 0.0 && reach_m <= kMostReach * cell_m_))
    throw Error(ErrorCode::Settings, "a reach is up to 8 cells");
}

void VoxelIndex::mark_near(const double* queries, std::size_t count, double reach_m, std::uint8_t* marks) const {
  check_reach(reach_m);
  const double most = reach_m * reach_m;
  for (std::size_t q = 0; q < count; ++q) {
    const double* query = queries + 3 * q;
    Place middle, low, high;
    if (!place_of(query, middle)) continue;
    for (int axis = 0; axis < 3; ++axis) {
      low[axis] = static_cast<std::int64_t>(std::floor((query[axis] - reach_m) / cell_m_)) + kMiddle;
      high[axis] = static_cast<std::int64_t>(std::floor((query[axis] + reach_m) / cell_m_)) + kMiddle;
    }
    for (std::int64_t x = low[0]; x <= high[0]; ++x)
      for (std::int64_t y = low[1]; y <= high[1]; ++y)
        for (std::int64_t z = low[2]; z <= high[2]; ++z) {
          const Cell* cell = find({x, y, z});
          if (cell == nullptr) continue;
          for (std::uint32_t i = cell->begin; i < cell->end; ++i)
            if (squared_distance(query, &points_[3 * std::size_t{i}]) <= most) marks[order_[i]] = 1;
        }
  }
}

void VoxelIndex::nearest(const double* queries, std::size_t count, double reach_m, std::int32_t* found) const {
  check_reach(reach_m);
  const auto rings = static_cast<std::int64_t>(std::ceil(reach_m / cell_m_));
  for (std::size_t q = 0; q < count; ++q) {
    const double* query = queries + 3 * q;
    found[q] = -1;
    Place middle;
    if (!place_of(query, middle)) continue;
    double inside = std::numeric_limits<double>::infinity();  // from the query to the nearest wall of its cell
    for (int axis = 0; axis < 3; ++axis) {
      const double from_wall = query[axis] - static_cast<double>(middle[axis] - kMiddle) * cell_m_;
      inside = std::min({inside, from_wall, cell_m_ - from_wall});
    }
    double best = reach_m * reach_m;
    for (std::int64_t ring = 0; ring <= rings; ++ring) {
      if (ring > 0) {
        const double reached = inside + static_cast<double>(ring - 1) * cell_m_;
        if (reached > 0.0 && best <= reached * reached) break;  // all points of this ring are further away
      }
      for (std::int64_t x = -ring; x <= ring; ++x)
        for (std::int64_t y = -ring; y <= ring; ++y) {
          const bool shell = x == -ring || x == ring || y == -ring || y == ring;
          for (std::int64_t z = -ring; z <= ring; z += shell || ring == 0 ? 1 : 2 * ring) {
            const Cell* cell = find({middle[0] + x, middle[1] + y, middle[2] + z});
            if (cell == nullptr) continue;
            for (std::uint32_t i = cell->begin; i < cell->end; ++i) {
              const double distance = squared_distance(query, &points_[3 * std::size_t{i}]);
              if (distance <= best && (distance < best || found[q] < 0)) {
                best = distance;
                found[q] = static_cast<std::int32_t>(order_[i]);
              }
            }
          }
        }
    }
  }
}

}  // namespace lidarcodec
