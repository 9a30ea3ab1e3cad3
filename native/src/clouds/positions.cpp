#include "clouds/positions.hpp"

#include <algorithm>
#include <cmath>

#include "base/varint.hpp"
#include "clouds/directions.hpp"
#include "clouds/measure.hpp"
#include "clouds/places.hpp"
#include "clouds/rests.hpp"

namespace lidarcodec {
namespace {

constexpr double kWorthRows = 2;  // bits of a direction from which on ByRow is tried
constexpr std::size_t kLookedAt = 4096;
constexpr double kWidest = 1e15;

std::int64_t whole(double value) {
  if (!(value > -kWidest)) value = -kWidest;  // not a number, too
  return static_cast<std::int64_t>(nearest(value > kWidest ? kWidest : value));
}

int exponent(float value) { return static_cast<int>(std::bit_cast<std::uint32_t>(value) >> 23 & 0xFF); }

// Contexts of the rests of coordinates: by how much larger the distance from the axis is, in powers of two (the last
// place of the coordinate is as much finer), and the length of the rest before it in the row.
class CoordinateContexts {
 public:
  explicit CoordinateContexts(std::size_t rows) : before_(rows) {}

  // Of a point, from the places and the distance that are told.
  void begin(std::size_t row, const CloudPlace& place) {
    lengths_ = &before_[row];
    far_ = exponent(static_cast<float>(place.rho));
  }
  std::uint8_t context(std::size_t axis, double coordinate) const {
    const int off = std::clamp(far_ - exponent(static_cast<float>(coordinate)) + 1, 0, kMost);
    return static_cast<std::uint8_t>((kMost + 1) * off + (*lengths_)[axis]);
  }
  void take(std::size_t axis, std::uint32_t rest) {
    (*lengths_)[axis] = static_cast<std::uint8_t>(std::min(static_cast<int>(std::bit_width(rest)), kMost));
  }

 private:
  static constexpr int kMost = 7;
  using Lengths = std::array<std::uint8_t, 3>;

  std::vector<Lengths> before_;
  Lengths* lengths_ = nullptr;
  int far_ = 0;
};

template <LeftForm kForm>
std::int64_t left_of(float value, double told, double unit) {
  if constexpr (kForm == LeftForm::LastPlaces) return ordered(value) - ordered(static_cast<float>(told));
  if constexpr (kForm == LeftForm::Decimals) return whole(static_cast<double>(value) * unit) - whole(told * unit);
  return whole((static_cast<double>(value) - told) / unit);
}

template <LeftForm kForm>
float back_of(double told, std::int64_t left, double unit) {
  if constexpr (kForm == LeftForm::LastPlaces) return from_ordered(ordered(static_cast<float>(told)) + left);
  if constexpr (kForm == LeftForm::Decimals)
    return static_cast<float>(static_cast<double>(whole(told * unit) + left) / unit);
  return static_cast<float>(told + static_cast<double>(left) * unit);
}

void put_sized(std::vector<std::uint8_t>& out, const std::vector<std::uint8_t>& part) {
  put_number(out, part.size());
  out.insert(out.end(), part.begin(), part.end());
}

void check_cells(const CloudCells& cells, const CloudGeometry& geometry) {
  check_cells(cells);
  if (geometry.rows.size() != cells.rows) throw Error(ErrorCode::Section, "a geometry of other rows than the image's");
}

// Bits that directions take, roughly.
double bits_of(Directions directions, const CloudCells& cells, const GivenPositions& given,
               std::span<const std::int32_t> k) {
  std::uint64_t bits = 0, count = 1;
  for (std::size_t i = 0; i < cells.row.size(); ++i) {
    if (given.returned[i] == 0) continue;
    const auto row = static_cast<std::size_t>(cells.row[i]), column = static_cast<std::size_t>(cells.column[i]);
    const std::int32_t told = directions.told(row, column), left = directions.wrapped(std::int64_t{k[i]} - told);
    bits += static_cast<std::uint64_t>(std::bit_width(zigzag(left)));
    ++count;
    directions.take(row, column, told, left);
  }
  return static_cast<double>(bits) / static_cast<double>(count);
}

// The usual step from point to point of a row.
std::int32_t usual_step(const Directions& directions, const CloudCells& cells, const GivenPositions& given,
                        std::span<const std::int32_t> k) {
  std::vector<std::optional<std::int32_t>> before(cells.rows);
  std::vector<std::int32_t> steps;
  for (std::size_t i = 0; i < cells.row.size() && steps.size() < kLookedAt; ++i) {
    if (given.returned[i] == 0) continue;
    std::optional<std::int32_t>& last = before[static_cast<std::size_t>(cells.row[i])];
    if (last) steps.push_back(directions.wrapped(std::int64_t{k[i]} - *last));
    last = k[i];
  }
  if (steps.empty()) return 0;
  const auto middle = steps.begin() + static_cast<std::ptrdiff_t>(steps.size() / 2);
  std::nth_element(steps.begin(), middle, steps.end());
  return *middle;
}

struct Chosen {
  DirectionForm form = DirectionForm::ByColumn;
  std::int32_t step = 0;
  Directions directions(const CloudGeometry& geometry, const CloudCells& cells) const {
    return {form, geometry.turn, step, cells.rows, cells.columns};
  }
};

Chosen choose(const CloudCells& cells, const CloudGeometry& geometry, const GivenPositions& given,
              std::span<const std::int32_t> k) {
  Chosen by_column;
  if (given.by_column) return by_column;
  const Directions directions = by_column.directions(geometry, cells);
  const double bits = bits_of(directions, cells, given, k);
  if (bits < kWorthRows) return by_column;
  Chosen by_row{DirectionForm::ByRow, usual_step(directions, cells, given, k)};
  return bits_of(by_row.directions(geometry, cells), cells, given, k) < bits ? by_row : by_column;
}

// The next points that have a range, kPoints of Places at most.
class Block {
 public:
  Block(const CloudCells& cells, const CloudGeometry& geometry)
      : cells_(cells), geometry_(geometry), places_(geometry) {}

  template <class Direction>
  bool next(std::span<const std::uint32_t> n, const Direction& direction) {
    for (count_ = 0; at_ < n.size() && count_ < Places::kPoints; ++at_) {
      if (n[at_] == 0) continue;
      points_[count_] = at_;
      row_[count_] = cells_.row[at_];
      n_[count_] = n[at_];
      k_[count_++] = direction(at_);
    }
    places_.find({row_.data(), count_}, n_.data(), k_.data());
    return count_ > 0;
  }

  std::size_t count() const { return count_; }
  std::size_t point(std::size_t i) const { return points_[i]; }
  std::int32_t k(std::size_t i) const { return k_[i]; }
  CloudPlace place(std::size_t i) const { return {places_.x[i], places_.y[i], places_.z[i], places_.rho[i]}; }

 private:
  const CloudCells& cells_;
  const CloudGeometry& geometry_;
  Places places_;
  std::size_t at_ = 0, count_ = 0;
  std::array<std::size_t, Places::kPoints> points_;
  std::array<std::int64_t, Places::kPoints> row_;
  std::array<std::uint32_t, Places::kPoints> n_;
  std::array<std::int32_t, Places::kPoints> k_;
};

double square_of(float a, float b) {
  const double off = static_cast<double>(a) - static_cast<double>(b);
  return off * off;
}

// What is left of the coordinates of a point, in zigzag; whether that tells them.
template <LeftForm kForm>
bool fits(const std::array<float, 3>& at, const CloudPlace& place, double unit, double bound,
          std::array<std::uint32_t, 4>& left) {
  const std::array<double, 3> told = {place.x, place.y, place.z};
  std::array<std::int64_t, 3> numbers;
  for (std::size_t axis = 0; axis < 3; ++axis) numbers[axis] = left_of<kForm>(at[axis], told[axis], unit);
  if constexpr (kForm == LeftForm::Metres) {
    double still = 0;
    for (std::size_t axis = 0; axis < 3; ++axis) still += square_of(at[axis], static_cast<float>(told[axis]));
    if (still <= bound) numbers = {0, 0, 0};
  }
  double moved = 0;
  bool same = true;
  for (std::size_t axis = 0; axis < 3; ++axis) {
    const float back = back_of<kForm>(told[axis], numbers[axis], unit);
    left[axis + 1] = zigzag(numbers[axis]);
    if constexpr (kForm == LeftForm::Metres)
      moved += square_of(at[axis], back);
    else
      same &= std::bit_cast<std::uint32_t>(back) == std::bit_cast<std::uint32_t>(at[axis]);
  }
  const std::uint32_t most = std::max(std::max(left[0], left[1]), std::max(left[2], left[3]));
  return most <= kMostRest && same && moved <= bound;
}

template <LeftForm kForm>
void encode_points(const CloudCells& cells, const CloudGeometry& geometry, double unit, const GivenPositions& given,
                   const Chosen& chosen, CodedPositions& coded) {
  Directions directions = chosen.directions(geometry, cells);
  RestWriter turned;
  std::array<RestWriter, 3> rests;
  turned.reserve(coded.n.size());
  for (RestWriter& one : rests) one.reserve(coded.n.size());
  const double bound = given.bound_m * given.bound_m;
  std::uint64_t bits = 0, count = 1;
  CoordinateContexts contexts(cells.rows);
  Block block(cells, geometry);
  while (block.next(coded.n, [&](std::size_t point) { return coded.k[point]; })) {
    for (std::size_t i = 0; i < block.count(); ++i) {
      const std::size_t point = block.point(i);
      const auto r = static_cast<std::size_t>(cells.row[point]), column = static_cast<std::size_t>(cells.column[point]);
      const std::int32_t told = directions.told(r, column);
      const std::uint8_t turned_context = directions.context(r, column);
      CloudPlace place = block.place(i);
      std::array<std::uint32_t, 4> left = {zigzag(directions.wrapped(std::int64_t{coded.k[point]} - told)), 0, 0, 0};
      if (given.returned[point] == 0 ||
          !fits<kForm>({given.xyz[0][point], given.xyz[1][point], given.xyz[2][point]}, place, unit, bound, left)) {
        coded.states[point] = PointState::Apart;
        coded.k[point] = told;
        left = {};
        place = place_of(geometry, geometry.rows[r], coded.n[point], told);
      }
      turned.add(left[0], turned_context);
      contexts.begin(r, place);
      const std::array<double, 3> coordinates = {place.x, place.y, place.z};
      for (std::size_t axis = 0; axis < 3; ++axis) {
        rests[axis].add(left[axis + 1], contexts.context(axis, coordinates[axis]));
        contexts.take(axis, left[axis + 1]);
      }
      directions.take(r, column, told, static_cast<std::int32_t>(unzigzag(left[0])));
      for (const std::uint32_t one : left) bits += static_cast<std::uint64_t>(std::bit_width(one));
      ++count;
    }
  }
  coded.bits = static_cast<double>(bits) / static_cast<double>(count);
  put_sized(coded.bytes, turned.finish());
  for (const RestWriter& one : rests) put_sized(coded.bytes, one.finish());
}

template <LeftForm kForm>
void decode_points(VarintReader& reader, Directions directions, const CloudCells& cells, const CloudGeometry& geometry,
                   double unit, std::span<const std::uint32_t> n, DecodedPositions& found) {
  RestReader turned(reader.sized()), x(reader.sized()), y(reader.sized()), z(reader.sized());
  const auto direction = [&](std::size_t point) {
    const auto row = static_cast<std::size_t>(cells.row[point]), column = static_cast<std::size_t>(cells.column[point]);
    const std::int32_t told = directions.told(row, column);
    const std::int64_t left = unzigzag(turned.next(directions.context(row, column)));
    return directions.take(row, column, told, static_cast<std::int32_t>(left));
  };
  CoordinateContexts contexts(cells.rows);
  const auto coordinate = [&](RestReader& rests, std::size_t axis, double told) {
    const std::uint32_t rest = rests.next(contexts.context(axis, told));
    contexts.take(axis, rest);
    return back_of<kForm>(told, unzigzag(rest), unit);
  };
  Block block(cells, geometry);
  while (block.next(n, direction)) {
    for (std::size_t i = 0; i < block.count(); ++i) {
      const std::size_t point = block.point(i);
      const CloudPlace place = block.place(i);
      contexts.begin(static_cast<std::size_t>(cells.row[point]), place);
      found.k[point] = block.k(i);
      found.xyz[0][point] = coordinate(x, 0, place.x);
      found.xyz[1][point] = coordinate(y, 1, place.y);
      found.xyz[2][point] = coordinate(z, 2, place.z);
    }
  }
  for (const RestReader* one : {&turned, &x, &y, &z}) one->finish();
}

}  // namespace

void check_cells(const CloudCells& cells) {
  const auto within = [](std::span<const std::int64_t> places, std::size_t size) {
    return std::all_of(places.begin(), places.end(),
                       [&](std::int64_t place) { return place >= 0 && place < static_cast<std::int64_t>(size); });
  };
  if (cells.row.size() != cells.column.size() || !within(cells.row, cells.rows) || !within(cells.column, cells.columns))
    throw Error(ErrorCode::Section, "points beyond the rows and columns of their image");
}

CodedPositions encode_positions(const CloudCells& cells, const CloudGeometry& geometry, const LeftUnit& unit,
                                const GivenPositions& given) {
  check_cells(cells, geometry);
  const std::size_t points = cells.row.size();
  const bool fits = given.returned.size() == points && (given.n.empty() || given.n.size() == points) &&
                    (given.k.empty() || given.k.size() == points) &&
                    std::all_of(given.xyz.begin(), given.xyz.end(),
                                [&](std::span<const float> axis) { return axis.size() == points; });
  if (!fits) throw Error(ErrorCode::Section, "positions that are not one for each point");
  CodedPositions coded;
  coded.states.resize(points);
  coded.n.assign(points, 1);
  coded.k.resize(points);
  const Directions none(DirectionForm::ByRow, geometry.turn, 0, 0, 0);
  std::vector<Measure> measures;
  for (const CloudRow& row : geometry.rows) measures.emplace_back(geometry, row);
  for (std::size_t i = 0; i < points; ++i) {
    if (given.returned[i] == 0) {
      const std::array<float, 3> at = {given.xyz[0][i], given.xyz[1][i], given.xyz[2][i]};
      if (given.none && std::bit_cast<std::array<std::uint32_t, 3>>(at) == *given.none) {
        coded.states[i] = PointState::Empty;
        coded.n[i] = 0;
      }
      continue;
    }
    Measured found{1, 0};
    if (given.n.empty() || given.k.empty())
      found = measures[static_cast<std::size_t>(cells.row[i])](given.xyz[0][i], given.xyz[1][i], given.xyz[2][i]);
    coded.n[i] = std::clamp(given.n.empty() ? found.n : given.n[i], 1u, kMostCloudRange);
    coded.k[i] = none.wrapped(given.k.empty() ? found.k : given.k[i]);
  }
  const Chosen chosen = choose(cells, geometry, given, coded.k);
  coded.by_column = chosen.form == DirectionForm::ByColumn;
  coded.bytes.push_back(static_cast<std::uint8_t>(chosen.form));
  if (chosen.form == DirectionForm::ByRow) put_number(coded.bytes, zigzag(chosen.step));
  switch (unit.form) {
    case LeftForm::LastPlaces:
      encode_points<LeftForm::LastPlaces>(cells, geometry, unit.unit, given, chosen, coded);
      break;
    case LeftForm::Decimals:
      encode_points<LeftForm::Decimals>(cells, geometry, unit.unit, given, chosen, coded);
      break;
    case LeftForm::Metres:
      encode_points<LeftForm::Metres>(cells, geometry, unit.unit, given, chosen, coded);
      break;
  }
  return coded;
}

DecodedPositions decode_positions(Bytes data, const CloudCells& cells, const CloudGeometry& geometry,
                                  const LeftUnit& unit, std::span<const std::uint32_t> n) {
  check_cells(cells, geometry);
  if (n.size() != cells.row.size()) throw Error(ErrorCode::Section, "ranges that are not one for each point");
  VarintReader reader(data, "positions");
  const std::uint8_t form = reader.byte();
  if (form > static_cast<std::uint8_t>(DirectionForm::ByRow))
    throw Error(ErrorCode::Section, "directions of unknown form " + std::to_string(form));
  Chosen chosen;
  chosen.form = static_cast<DirectionForm>(form);
  if (chosen.form == DirectionForm::ByRow)
    chosen.step = static_cast<std::int32_t>(reader.signed_number(geometry.turn / 2));
  DecodedPositions found;
  for (std::vector<float>& axis : found.xyz) axis.resize(n.size());
  found.k.resize(n.size());
  const Directions directions = chosen.directions(geometry, cells);
  switch (unit.form) {
    case LeftForm::LastPlaces:
      decode_points<LeftForm::LastPlaces>(reader, directions, cells, geometry, unit.unit, n, found);
      break;
    case LeftForm::Decimals:
      decode_points<LeftForm::Decimals>(reader, directions, cells, geometry, unit.unit, n, found);
      break;
    case LeftForm::Metres:
      decode_points<LeftForm::Metres>(reader, directions, cells, geometry, unit.unit, n, found);
      break;
  }
  reader.end();
  return found;
}

}  // namespace lidarcodec
