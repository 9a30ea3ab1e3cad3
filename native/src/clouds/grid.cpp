#include "clouds/grid.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>
#include <numeric>

#include "clouds/columns.hpp"

namespace lidarcodec {
namespace {

constexpr std::size_t kMostRows = 128, kMostCells = std::size_t{1} << 20, kMostColumns = 24'576;
constexpr std::size_t kCellsPerPoint = 8, kFewCells = 4096, kOfEachRing = 256;
constexpr double kTurn = 2 * std::numbers::pi, kBetweenLines = 0.0007, kFarthest = 1e6;
constexpr double kLeastStep = 1e-5, kMostStep = 0.2, kLeastJump = 1e-4;
constexpr std::size_t kFewLines = 4;

using Rings = std::vector<std::int64_t>;
using Angles = std::vector<double>;

double wrapped(double angle) { return angle - std::nearbyint(angle / kTurn) * kTurn; }

// 0 or more, below `by`.
double modulo(double value, double by) {
  const double rest = std::fmod(value, by);
  return rest < 0 ? rest + by : rest;
}

double sign(double value) { return value > 0 ? 1.0 : value < 0 ? -1.0 : 0.0; }

// Of some values, which it sorts in part.
double median(Angles& values) {
  const auto half = static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), values.begin() + half, values.end());
  const double upper = values[static_cast<std::size_t>(half)];
  if (values.size() % 2 != 0) return upper;
  return (*std::max_element(values.begin(), values.begin() + half) + upper) / 2;
}

bool fits(std::size_t rows, std::size_t columns, std::size_t points) {
  return columns <= kMostColumns && rows * columns <= std::max(kCellsPerPoint * points, kFewCells) &&
         rows * columns <= kMostCells;
}

std::size_t index(std::int64_t ring) { return static_cast<std::size_t>(ring); }

// Direction of each point in radians; of a point without a return that of the one before.
Angles azimuths(const CloudAxes& axes) {
  Angles found(axes.x.size());
  double last = 0;
  for (std::size_t i = 0; i < found.size(); ++i) {
    if (axes.returned[i]) last = std::atan2(axes.y[i], axes.x[i]);
    found[i] = last;
  }
  return found;
}

// Whether points that come ring by ring fit into rows: columns by azimuth, at least one after the point before.
bool come_row_by_row(const Rings& rings, const Angles& azimuth, std::size_t rows) {
  Angles steps, ways;
  for (std::size_t i = 1; i < rings.size(); ++i) {
    if (rings[i] < rings[i - 1]) return false;
    if (rings[i] != rings[i - 1]) continue;
    ways.push_back(wrapped(azimuth[i] - azimuth[i - 1]));
    steps.push_back(std::abs(ways.back()));
  }
  const double step = steps.empty() ? 0.0 : median(steps);
  if (!(step > kLeastStep && step < kMostStep)) return false;
  const double way = sign(median(ways)), forward = way == 0 ? 1.0 : way;
  std::int64_t least = std::numeric_limits<std::int64_t>::max(), most = 0, next = 0;
  for (std::size_t i = 0; i < rings.size(); ++i) {
    const auto column = static_cast<std::int64_t>(modulo((azimuth[i] - azimuth[0]) * forward + 0.25, kTurn) / step);
    next = i > 0 && rings[i] == rings[i - 1] ? std::max(column, next) : column;
    least = std::min(least, next);
    most = std::max(most, next);
    ++next;
  }
  return fits(rows, static_cast<std::size_t>(most - least + 1), rings.size());
}

// Rings in the order in which they fire: mostly, each is followed by the next.
Rings firing_order(const Rings& rings, std::size_t rows) {
  std::vector<std::uint32_t> follows(rows * rows);
  for (std::size_t i = 1; i < rings.size(); ++i)
    if (rings[i] != rings[i - 1]) ++follows[index(rings[i - 1]) * rows + index(rings[i])];
  std::vector<std::size_t> after(rows);
  std::vector<bool> is_followed(rows);
  for (std::size_t ring = 0; ring < rows; ++ring) {
    const auto from = follows.begin() + static_cast<std::ptrdiff_t>(ring * rows);
    const auto best = std::max_element(from, from + static_cast<std::ptrdiff_t>(rows));
    after[ring] = static_cast<std::size_t>(best - from);
    is_followed[ring] = *best > 0;
  }
  std::vector<bool> in_chain(rows);
  Rings chain;
  for (std::size_t ring = index(rings[0]); !in_chain[ring]; ring = after[ring]) {
    chain.push_back(static_cast<std::int64_t>(ring));
    in_chain[ring] = true;
  }
  for (bool found = true; found;) {
    found = false;
    for (std::size_t ring = rows; ring-- > 0 && !found;) {
      if (in_chain[ring] || !in_chain[after[ring]] || !is_followed[ring]) continue;
      chain.insert(std::find(chain.begin(), chain.end(), static_cast<std::int64_t>(after[ring])),
                   static_cast<std::int64_t>(ring));
      in_chain[ring] = found = true;
    }
  }
  for (std::size_t ring = 0; ring < rows; ++ring)
    if (!in_chain[ring]) chain.push_back(static_cast<std::int64_t>(ring));
  return chain;
}

// Adds to the offset of each ring the median of some of its angles.
void add_medians(const Angles& angles, const Rings& rings, Angles& offset) {
  std::vector<Angles> of_ring(offset.size());
  const std::size_t step = std::max<std::size_t>(1, rings.size() / (kOfEachRing * offset.size()));
  for (std::size_t i = 0; i < rings.size(); i += step) of_ring[index(rings[i])].push_back(angles[i]);
  for (std::size_t ring = 0; ring < offset.size(); ++ring)
    if (!of_ring[ring].empty()) offset[ring] += median(of_ring[ring]);
}

// Radians from which on a point is in another direction than the one before: more than half a column.
double jump_of(const Angles& steps, const std::vector<bool>& anew) {
  Angles between;
  const auto begins = static_cast<std::size_t>(std::count(anew.begin(), anew.end(), true));
  for (std::size_t i = 1; i < steps.size(); ++i)
    if (anew[i]) between.push_back(steps[i]);
  const double jump =
      std::max(between.empty() ? std::numeric_limits<double>::infinity() : 0.6 * median(between), kLeastJump);
  std::size_t jumps = 0;
  for (std::size_t i = 0; i < steps.size(); ++i) jumps += !anew[i] && steps[i] > jump;
  // Lasers beside the axis look in directions that depend on the range: then these are no jumps.
  return static_cast<double>(jumps) < 0.3 * static_cast<double>(begins) ? jump
                                                                        : std::numeric_limits<double>::infinity();
}

// Whether points come ring by ring, or column by column in few columns.
bool come_by_rings(const CloudAxes& axes, const Rings& rings, const Angles& azimuth, std::size_t rows) {
  const std::size_t points = rings.size();
  std::size_t same = 0;
  for (std::size_t i = 1; i < points; ++i) same += rings[i] == rings[i - 1];
  if (points > 1 && static_cast<double>(same) / static_cast<double>(points - 1) > 0.5)
    return come_row_by_row(rings, azimuth, rows);
  const Rings firing = firing_order(rings, rows);
  Rings rank(rows);
  for (std::size_t place = 0; place < rows; ++place) rank[index(firing[place])] = static_cast<std::int64_t>(place);
  std::vector<bool> anew(points, true);
  for (std::size_t i = 1; i < points; ++i) anew[i] = rank[index(rings[i])] <= rank[index(rings[i - 1])];
  std::vector<bool> begins = anew;
  Angles offset(rows), turned(points), steps(points);
  double jump = std::numeric_limits<double>::infinity();
  for (int round = 0; round < 3; ++round) {  // rings look in different directions: learn by how much, then cut
    for (int again = 0; again < 2; ++again) {
      double begun = 0;
      for (std::size_t i = 0; i < points; ++i) {
        const double level = azimuth[i] - offset[index(rings[i])];
        if (begins[i]) begun = level;
        turned[i] = wrapped(level - begun);
      }
      add_medians(turned, rings, offset);
    }
    const auto level = [&](std::size_t i) { return azimuth[i] - offset[index(rings[i])]; };
    for (std::size_t i = 1; i < points; ++i) steps[i] = std::abs(wrapped(level(i) - level(i - 1)));
    jump = jump_of(steps, anew);
    for (std::size_t i = 0; i < points; ++i) begins[i] = anew[i] || steps[i] > jump;
  }
  std::vector<float> x, y;
  std::vector<std::uint8_t> returned;
  for (std::size_t i = 0; i < points; ++i) {
    x.push_back(static_cast<float>(axes.x[i]));
    y.push_back(static_cast<float>(axes.y[i]));
    returned.push_back(axes.returned[i]);
  }
  const Rings column = columns_of_firing({rank, offset, jump}, rings, x, y, returned);
  return fits(rows, index(column.back()) + 1, points);
}

// Points that come turn by turn: a row ends where the azimuth has passed that of the first point.
std::optional<CloudRows> by_turns(const Angles& azimuth) {
  Angles steps;
  for (std::size_t i = 1; i < azimuth.size(); ++i) steps.push_back(wrapped(azimuth[i] - azimuth[i - 1]));
  Angles sorted = steps;
  const double forward = steps.empty() ? 0.0 : sign(median(sorted));
  const auto along = std::count_if(steps.begin(), steps.end(), [&](double step) { return sign(step) == forward; });
  if (forward == 0 || static_cast<double>(along) / static_cast<double>(steps.size()) < 0.8) return std::nullopt;
  CloudRows found;
  std::int64_t row = 0;
  double before = 0;
  for (const double one : azimuth) {
    const double turned = modulo((one - azimuth[0]) * forward, kTurn);
    row += turned - before < -std::numbers::pi;
    before = turned;
    found.row.push_back(row);
  }
  found.rows = index(row) + 1;
  if (found.rows > kMostRows || !come_row_by_row(found.row, azimuth, found.rows)) return std::nullopt;
  return found;
}

// The line of elevation of each point, the highest first; nothing if they form no lines.
std::optional<CloudRows> lines_of(const CloudAxes& axes) {
  const std::size_t points = axes.x.size();
  Angles elevation(points);
  for (std::size_t i = 0; i < points; ++i) elevation[i] = std::atan2(axes.z[i], std::hypot(axes.x[i], axes.y[i]));
  std::vector<std::size_t> order(points);
  std::iota(order.begin(), order.end(), std::size_t{0});
  std::stable_sort(order.begin(), order.end(),
                   [&](std::size_t a, std::size_t b) { return elevation[a] < elevation[b]; });
  CloudRows found;
  found.row.resize(points);
  std::int64_t number = 0;
  for (std::size_t i = 0; i < points; ++i) {
    if (i > 0 && elevation[order[i]] - elevation[order[i - 1]] > kBetweenLines) ++number;
    found.row[order[i]] = number;
  }
  found.rows = index(number) + 1;
  if (found.rows < kFewLines || found.rows > kMostRows) return std::nullopt;
  for (std::int64_t& row : found.row) row = number - row;
  return found;
}

// The rings of a field; nothing if it has no whole numbers below 128.
std::optional<CloudRows> rings_of(const CloudPoints& points, const CloudField& field) {
  if (field.is_float()) return std::nullopt;
  CloudRows found;
  for (std::size_t i = 0; i < points.size(); ++i) {
    const double ring = points.number(field, i);
    if (!(ring >= 0 && ring < static_cast<double>(kMostRows))) return std::nullopt;
    found.row.push_back(static_cast<std::int64_t>(ring));
    found.rows = std::max(found.rows, index(found.row.back()) + 1);
  }
  return found;
}

}  // namespace

std::optional<CloudAxes> axes_of(const CloudPoints& points) {
  const CloudField *const x = points.head().named("x"), *const y = points.head().named("y"),
                          *const z = points.head().named("z");
  if (x == nullptr || y == nullptr || z == nullptr || !x->is_float() || !y->is_float() || !z->is_float())
    return std::nullopt;
  CloudAxes axes;
  for (std::size_t i = 0; i < points.size(); ++i) {
    const double at[] = {points.number(*x, i), points.number(*y, i), points.number(*z, i)};
    const auto near = [](double value) { return std::abs(value) < kFarthest; };  // not of what is no number
    const bool there = near(at[0]) && near(at[1]) && near(at[2]) && (at[0] != 0 || at[1] != 0 || at[2] != 0);
    axes.x.push_back(there ? at[0] : 0.0);
    axes.y.push_back(there ? at[1] : 0.0);
    axes.z.push_back(there ? at[2] : 0.0);
    axes.returned.push_back(there);
  }
  return axes;
}

std::optional<CloudRows> rows_of(const CloudPoints& points, const CloudAxes& axes) {
  const CloudHead& head = points.head();
  const std::size_t count = points.size();
  if (count == 0) return std::nullopt;
  if (head.height > 1 && head.height <= kMostRows && head.width <= kMostColumns && count <= kMostCells) {
    CloudRows found{head.height, {}};
    for (std::size_t i = 0; i < count; ++i) found.row.push_back(static_cast<std::int64_t>(i / head.width));
    return found;
  }
  if (std::find(axes.returned.begin(), axes.returned.end(), true) == axes.returned.end()) return std::nullopt;
  const Angles azimuth = azimuths(axes);
  for (const char* const name : {"ring", "channel", "laser_id", "line"}) {
    const CloudField* const field = head.named(name);
    std::optional<CloudRows> found = field == nullptr ? std::nullopt : rings_of(points, *field);
    if (found && come_by_rings(axes, found->row, azimuth, found->rows)) return found;
  }
  if (std::optional<CloudRows> turns = by_turns(azimuth)) return turns;
  std::optional<CloudRows> lines = lines_of(axes);
  if (lines && come_by_rings(axes, lines->row, azimuth, lines->rows)) return lines;
  return std::nullopt;
}

}  // namespace lidarcodec
