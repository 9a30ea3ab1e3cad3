#include "maps/points.hpp"

#include <algorithm>
#include <numeric>
#include <string>

#include "maps/cells.hpp"

namespace lidarcodec {
namespace {

using Point = std::array<std::uint32_t, 3>;

// A guess of a number, and how well it is known: 0 to 5, 0 = best.
struct Guess {
  double at;
  unsigned doubt;
};

// Numbers below a limit that are guessed before they are coded. A decision halves what is left; its context is how far
// the guess lies from the middle, in halves of what is left.
class NumberCoder {
 public:
  explicit NumberCoder(std::size_t roles)
      : by_first_(roles * kPlaces),
        by_second_(roles * kPlaces),
        by_both_(roles * kSides * kSides * kLevels * 2),
        by_range_(roles * kLevels * 64),
        mixes_(roles * kLevels) {}

  template <class Bits>
  std::uint32_t code(Bits& bits, std::uint32_t wanted, std::uint32_t limit, std::size_t role, const Guess& first,
                     const Guess& second) {
    std::uint32_t low = 0, left = 1;
    while (left < limit) left *= 2;
    std::size_t node = 1;
    unsigned level = 0;
    for (std::uint32_t rest = left; rest > 1; rest /= 2) ++level;
    while (left > 1) {
      left /= 2;
      --level;
      const std::uint32_t middle = low + left;
      if (middle >= limit) continue;  // the upper half is empty
      const unsigned deep = std::min(level, kLevels - 1);
      const double scale = 4.0 / static_cast<double>(left);
      const unsigned one = side((first.at - static_cast<double>(middle)) * scale);
      const unsigned two = side((second.at - static_cast<double>(middle)) * scale);
      const std::array<BitModel*, 4> models = {
          by_first_.at(role * kPlaces + (first.doubt * kLevels + deep) * kSides + one),
          by_second_.at(role * kPlaces + (second.doubt * kLevels + deep) * kSides + two),
          by_both_.at((((role * kSides + one) * kSides + two) * kLevels + deep) * 2 + (first.doubt > 2)),
          by_range_.at((role * kLevels + deep) * 64 + std::min<std::size_t>(node, 63)),
      };
      const bool upper = mixes_[role * kLevels + deep].code(bits, wanted >= middle, models);
      node = node * 2 + upper;
      if (upper) low = middle;
    }
    return low;
  }

 private:
  static constexpr unsigned kLevels = 6, kSides = 25;
  static constexpr std::size_t kPlaces = 6 * kLevels * kSides;

  // -12 to 12 as 0 to 24.
  static unsigned side(double apart) {
    const double clipped = std::clamp(apart, -12.0, 12.0);
    return static_cast<unsigned>(static_cast<int>(clipped + 12.5));
  }

  Models by_first_, by_second_, by_both_, by_range_;
  std::vector<Mix<4>> mixes_;
};

// The coded points around a cell.
class Neighbours {
 public:
  Neighbours(const TileForm& form, std::size_t most) : form_(&form), first_(most / 4 + 16), next_(most) {}

  void add(const Point& point, std::size_t place) {
    std::uint32_t& first = first_[key(point, {0, 0, 0})];
    next_[place] = first;
    first = static_cast<std::uint32_t>(place);
  }

  // Up to kMost of the nearest ones to the middle of a cell, nearest first, with squared distances.
  void find(const std::vector<Point>& points, const Cell& cell) {
    count = 0;
    std::array<double, 3> middle;
    Point corner;
    for (std::size_t axis = 0; axis < 3; ++axis) {
      corner[axis] = cell[axis] * form_->cell;
      middle[axis] = static_cast<double>(corner[axis]) + 0.5 * static_cast<double>(form_->cell - 1);
    }
    for (int z = -1; z <= 1; ++z) {
      for (int y = -1; y <= 1; ++y) {
        for (int x = -1; x <= 1; ++x) {
          unsigned looked = 0;
          for (std::uint32_t at = first_.find(key(corner, {x, y, z})); at != CellIndex::kNone && looked < kLooked;
               at = next_[at], ++looked) {
            double squared = 0;
            for (std::size_t axis = 0; axis < 3; ++axis) {
              const double off = static_cast<double>(points[at][axis]) - middle[axis];
              squared += off * off;
            }
            put(at, squared);
          }
        }
      }
    }
  }

  static constexpr std::size_t kMost = 10;
  std::size_t count = 0;
  std::array<std::uint32_t, kMost> places;
  std::array<double, kMost> squares;

 private:
  static constexpr unsigned kLooked = 24;

  std::uint64_t key(const Point& point, const std::array<int, 3>& off) const {
    const std::uint32_t width = form_->cell * form_->reach;
    Cell bin;
    // One more, so that no bin is below 0.
    for (std::size_t axis = 0; axis < 3; ++axis)
      bin[axis] = point[axis] / width + 1 + static_cast<std::uint32_t>(off[axis]);
    return morton_of(bin);
  }

  void put(std::uint32_t place, double squared) {
    if (count == kMost && squared >= squares[kMost - 1]) return;
    std::size_t at = count < kMost ? count++ : kMost - 1;
    for (; at > 0 && squares[at - 1] > squared; --at) {
      squares[at] = squares[at - 1];
      places[at] = places[at - 1];
    }
    squares[at] = squared;
    places[at] = place;
  }

  const TileForm* form_;
  CellIndex first_;
  std::vector<std::uint32_t> next_;
};

// A plane through neighbours: the axis that it gives, as a function of the other two.
struct Plane {
  std::size_t axis = 2;
  unsigned doubt = 5;
  std::array<double, 3> mean{}, slope{};

  double at(const std::array<double, 3>& point) const {
    double value = mean[axis];
    for (std::size_t other = 0; other < 3; ++other)
      if (other != axis) value += slope[other] * (point[other] - mean[other]);
    return value;
  }
};

// The plane of least squares, of the three directions the one that leaves the least. Only sums, products and quotients:
// these are the same on every machine.
Plane plane_of(const std::vector<Point>& points, const Neighbours& near, double cell) {
  Plane best;
  if (near.count == 0) return best;
  double total = 0;
  std::array<double, 3> mean{};
  std::array<double, Neighbours::kMost> weights;
  for (std::size_t i = 0; i < near.count; ++i) {
    weights[i] = 1.0 / (near.squares[i] + cell * cell);
    total += weights[i];
    for (std::size_t axis = 0; axis < 3; ++axis)
      mean[axis] += weights[i] * static_cast<double>(points[near.places[i]][axis]);
  }
  for (double& value : mean) value /= total;
  best.mean = mean;
  if (near.count < 3) return best;
  std::array<std::array<double, 3>, 3> spread{};
  for (std::size_t i = 0; i < near.count; ++i) {
    std::array<double, 3> off;
    for (std::size_t axis = 0; axis < 3; ++axis)
      off[axis] = static_cast<double>(points[near.places[i]][axis]) - mean[axis];
    for (std::size_t a = 0; a < 3; ++a)
      for (std::size_t b = 0; b < 3; ++b) spread[a][b] += weights[i] / total * off[a] * off[b];
  }
  double least = 0;
  const double ridge = 0.02 * cell * cell + 0.1;
  for (std::size_t axis = 0; axis < 3; ++axis) {
    const std::size_t u = (axis + 1) % 3, v = (axis + 2) % 3;
    const double uu = spread[u][u] + ridge, vv = spread[v][v] + ridge, uv = spread[u][v];
    const double du = spread[axis][u], dv = spread[axis][v], det = uu * vv - uv * uv;
    const double su = (du * vv - dv * uv) / det, sv = (dv * uu - du * uv) / det;
    const double rest = spread[axis][axis] - su * du - sv * dv;
    if (axis > 0 && rest >= least) continue;
    least = rest;
    best.axis = axis;
    best.slope = {};
    best.slope[u] = su;
    best.slope[v] = sv;
  }
  constexpr std::array<double, 4> limits = {0.3, 1.0, 4.0, 16.0};  // squared steps
  best.doubt = 0;
  for (const double limit : limits) best.doubt += least > limit;
  if (near.count < 5) best.doubt = std::min(best.doubt + 1, 5u);
  return best;
}

class TileCoder {
 public:
  TileCoder(const TileForm& form, std::size_t count)
      : form_(&form), more_(4), offsets_(9), columns_(2 * kMostColumns), near_(form, count) {}

  // Reads or writes all points, in the order of their cells.
  template <class Bits>
  void code(Bits& bits, TilePoints& tile, std::size_t count) {
    std::vector<std::uint64_t> cells;
    std::vector<std::uint32_t> in_cell;
    if constexpr (!Bits::kReads) {
      for (const Point& point : tile.points) {
        const std::uint64_t code = cell_code(point);
        if (cells.empty() || cells.back() != code) {
          cells.push_back(code);
          in_cell.push_back(0);
        }
        ++in_cell.back();
      }
    }
    cells_.code(bits, cells, form_->levels, count);
    if constexpr (Bits::kReads) tile.points.reserve(count);
    std::size_t place = 0;
    for (std::size_t at = 0; at < cells.size(); ++at) {
      const std::size_t spare = count - place - (cells.size() - at);  // beyond one point for each cell to come
      std::size_t more = 0;
      for (; more < spare; ++more) {
        BitModel& model = *more_.at(std::min<std::size_t>(more, 3));
        const bool another = bits.bit(Bits::kReads ? false : more + 1 < in_cell[at], model.probability());
        model.update(another);
        if (!another) break;
      }
      const Cell cell = cell_of(cells[at]);
      for (std::size_t i = 0; i <= more; ++i, ++place) code_point(bits, tile, place, cell);
    }
    if (place != count) throw Error(ErrorCode::Section, "a tile has fewer points than it announces");
  }

  std::uint64_t cell_code(const Point& point) const {
    return morton_of({point[0] / form_->cell, point[1] / form_->cell, point[2] / form_->cell});
  }

 private:
  template <class Bits>
  void code_point(Bits& bits, TilePoints& tile, std::size_t place, const Cell& cell) {
    near_.find(tile.points, cell);
    const Plane plane = plane_of(tile.points, near_, static_cast<double>(form_->cell));
    Point point{};
    if constexpr (!Bits::kReads) point = tile.points[place];
    std::array<double, 3> known;
    for (std::size_t turn = 1; turn <= 3; ++turn) {
      const std::size_t axis = (plane.axis + turn) % 3;
      const std::uint32_t corner = cell[axis] * form_->cell;
      const double low = static_cast<double>(corner);
      const Guess by_plane{turn == 3 ? plane.at(known) - low : plane.mean[axis] - low, turn == 3 ? plane.doubt : 5u};
      const bool any = near_.count > 0;
      const Guess nearest{any ? static_cast<double>(tile.points[near_.places[0]][axis]) - low : 0.0,
                          any ? std::min(plane.doubt, 4u) : 5u};
      const std::size_t role = (turn == 3 ? 0 : turn * 3) + axis;
      point[axis] = corner + offsets_.code(bits, point[axis] - corner, form_->cell, role, by_plane, nearest);
      known[axis] = static_cast<double>(point[axis]);
    }
    if constexpr (Bits::kReads) tile.points.push_back(point);
    code_columns(bits, tile, place);
    near_.add(point, place);
  }

  template <class Bits>
  void code_columns(Bits& bits, TilePoints& tile, std::size_t place) {
    const std::size_t columns = form_->bits.size(), near = std::min<std::size_t>(near_.count, 4);
    for (std::size_t column = 0; column < columns; ++column) {
      Guess nearest{0.0, 5}, mean{0.0, 5};
      if (near > 0) {
        double sum = 0, least = 1e9, most = 0;
        for (std::size_t i = 0; i < near; ++i) {
          const double value = tile.values[near_.places[i] * columns + column];
          sum += value;
          least = std::min(least, value);
          most = std::max(most, value);
        }
        mean = {sum / static_cast<double>(near), doubt_of(most - least)};
        nearest = {static_cast<double>(tile.values[near_.places[0] * columns + column]), mean.doubt};
      }
      const std::uint32_t wanted = Bits::kReads ? 0 : tile.values[place * columns + column];
      const std::uint32_t value = columns_.code(bits, wanted, 1u << form_->bits[column], column, mean, nearest);
      if constexpr (Bits::kReads) tile.values.push_back(static_cast<std::uint16_t>(value));
    }
  }

  static unsigned doubt_of(double apart) {
    constexpr std::array<double, 4> limits = {0.5, 2.0, 8.0, 32.0};
    unsigned doubt = 0;
    for (const double limit : limits) doubt += apart > limit;
    return doubt;
  }

  const TileForm* form_;
  CellCoder cells_;
  Models more_;
  NumberCoder offsets_, columns_;
  Neighbours near_;
};

void check(const TileForm& form, std::size_t count, ErrorCode code) {
  const bool fits = form.levels <= kMapLevels && form.cell >= 1 && form.cell <= kMostCell && form.reach >= 1 &&
                    form.reach <= 256 && static_cast<std::uint64_t>(form.cell) << form.levels <= kMostSteps &&
                    form.bits.size() <= kMostColumns &&
                    std::all_of(form.bits.begin(), form.bits.end(),
                                [](unsigned bits) { return bits >= 1 && bits <= kMostColumnBits; });
  if (!fits) throw Error(code, "a tile of a map has a form that no encoder writes");
  if (count < 1 || count > kMostTilePoints)
    throw Error(
        code, "a tile of a map has 1 to " + std::to_string(kMostTilePoints) + " points, not " + std::to_string(count));
}

}  // namespace

std::vector<std::uint8_t> encode_tile(const TilePoints& tile, const TileForm& form) {
  const std::size_t count = tile.points.size(), columns = form.bits.size();
  check(form, count, ErrorCode::Settings);
  TileCoder coder(form, count);
  std::vector<std::uint64_t> codes(count);
  const std::uint32_t limit = form.cell << form.levels;
  for (std::size_t i = 0; i < count; ++i) {
    for (const std::uint32_t value : tile.points[i])
      if (value >= limit) throw Error(ErrorCode::Settings, "a point lies outside of its tile");
    codes[i] = coder.cell_code(tile.points[i]);
  }
  std::vector<std::size_t> order(count);
  std::iota(order.begin(), order.end(), std::size_t{0});
  std::sort(order.begin(), order.end(), [&](std::size_t a, std::size_t b) {
    return codes[a] != codes[b] ? codes[a] < codes[b] : tile.points[a] < tile.points[b];
  });
  TilePoints sorted;
  sorted.points.reserve(count);
  for (const std::size_t place : order) {
    sorted.points.push_back(tile.points[place]);
    for (std::size_t column = 0; column < columns; ++column) {
      const std::uint16_t value = tile.values[place * columns + column];
      if (value >> form.bits[column] != 0) throw Error(ErrorCode::Settings, "a value has more bits than its column");
      sorted.values.push_back(value);
    }
  }
  std::vector<std::uint8_t> data;
  BitWriter bits(data);
  coder.code(bits, sorted, count);
  bits.finish();
  return data;
}

TilePoints decode_tile(Bytes data, std::size_t count, const TileForm& form) {
  check(form, count, ErrorCode::Section);
  TileCoder coder(form, count);
  TilePoints tile;
  BitReader bits(data.data(), data.size());
  coder.code(bits, tile, count);
  bits.finish();
  return tile;
}

}  // namespace lidarcodec
