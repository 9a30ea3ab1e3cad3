// Points of clouds: any bytes as coordinates, as rests and as sums of columns and rows, the same there and back, and
// what is coded with a byte changed. The input's first bytes say kind, sizes and geometry.
#include <algorithm>
#include <bit>
#include <cmath>
#include <cstdlib>
#include <optional>

#include "base/error.hpp"
#include "clouds/columns.hpp"
#include "clouds/points.hpp"
#include "clouds/positions.hpp"
#include "clouds/rest_tables.hpp"
#include "parts/fuzz_input.hpp"

using namespace lidarcodec;
using Bytes8 = std::vector<std::uint8_t>;

namespace {

constexpr std::uint32_t kMostRange = (1u << 20) - 1;

// Points of an image: each cell, or those that numbers name, row by row or column by column.
struct Image {
  std::size_t rows, columns;
  std::vector<std::int64_t> row, column;
  std::vector<std::uint32_t> ranges;

  CloudCells cells() const { return {rows, columns, row, column}; }
};

Image image_of(FuzzInput& input) {
  Image image;
  image.rows = 1 + input.byte() % 9;
  image.columns = 1 + input.byte() % 40;
  const std::uint8_t kind = input.byte(), holes = input.byte();
  for (std::size_t cell = 0; cell < image.rows * image.columns; ++cell)
    image.ranges.push_back((cell * 2654435761u >> 7) % 256 >= holes ? 1 : 0);
  std::vector<std::int64_t> firing;
  for (std::size_t row = 0; row < image.rows; ++row) firing.push_back(static_cast<std::int64_t>(row));
  std::rotate(firing.begin(), firing.begin() + static_cast<std::ptrdiff_t>(kind / 4 % image.rows), firing.end());
  PointOrder order{image.rows, image.columns, (kind & 1u) != 0, firing, {}};
  if ((kind & 2u) != 0) order.ranges = image.ranges;
  PointCells cells = cells_of_points(order);
  image.row = std::move(cells.row);
  image.column = std::move(cells.column);
  return image;
}

// Steps of a turn from the fewest to the most that a section may have.
constexpr std::array<std::uint32_t, 6> kTurns = {1, 2, 36'000, 1u << 16, (1u << 18) + 1, 1u << 28};
constexpr std::array<double, 4> kSteps = {1e-8, 0.002, 0.004, 999.0};
constexpr std::array<double, 5> kUnits = {1e-8, 0.01, 1.0, 1000.0, 999'999.0};

// A geometry within what the reader of a section lets through: numbers of rows are any.
CloudGeometry geometry_of(FuzzInput& input, Numbers& numbers, std::size_t rows, LeftUnit& unit) {
  const std::uint8_t kind = input.byte(), more = input.byte();
  CloudGeometry geometry;
  geometry.turn = kTurns[kind % kTurns.size()];
  geometry.step_m = kSteps[more % kSteps.size()];
  geometry.narrow = (kind & 64u) != 0;
  geometry.angles = static_cast<std::uint8_t>(more / 4 % kAngleForms.size());
  unit.form = static_cast<LeftForm>(more / 32 % 3);
  unit.unit = kUnits[kind / 8 % kUnits.size()];
  const bool wild = (kind & 128u) != 0;
  for (std::size_t row = 0; row < rows; ++row) {
    const auto any = [&] { return static_cast<double>(static_cast<std::int32_t>(numbers.next(4))) * 1e9; };
    const double tilt = 0.1 * static_cast<double>(row) - 0.3;
    if (wild)
      geometry.rows.push_back({any(), any(), any(), any(), any(), std::fmod(any(), 4294967295.0)});
    else
      geometry.rows.push_back({1 - tilt * tilt / 2, 0.02, tilt, 0.1, 0.01, static_cast<double>(row)});
  }
  return geometry;
}

std::vector<std::uint32_t> ranges_of(Numbers& numbers, std::size_t count, std::uint8_t kind) {
  std::vector<std::uint32_t> n(count);
  for (std::uint32_t& one : n) one = kind % 4 == 0 ? kMostRange : numbers.next(1 + kind % 3) & kMostRange;
  return n;
}

void decode_any(const Bytes8& data, const Image& image, const CloudGeometry& geometry, const LeftUnit& unit,
                std::span<const std::uint32_t> n) {
  try {
    const DecodedPositions found = decode_positions(Bytes(data.data(), data.size()), image.cells(), geometry, unit, n);
    if (found.k.size() != n.size() || found.xyz[0].size() != n.size() || found.xyz[2].size() != n.size()) std::abort();
    const std::int64_t half = geometry.turn / 2;
    for (const std::int32_t k : found.k)
      if (k < -half || k > half) std::abort();
  } catch (const Error&) {
  }
}

bool same_bits(float one, float other) {
  return std::bit_cast<std::uint32_t>(one) == std::bit_cast<std::uint32_t>(other);
}

// Coordinates: those of the geometry with a little beside, or any at all.
void check_positions(const Image& image, const CloudGeometry& geometry, const LeftUnit& unit, Numbers& numbers,
                     std::uint8_t kind) {
  const std::size_t points = image.row.size();
  Coordinates xyz;
  std::vector<std::uint8_t> returned;
  const std::vector<std::uint32_t> ranges = ranges_of(numbers, points, kind / 4);
  std::vector<std::int32_t> known;
  for (std::size_t i = 0; i < points; ++i) {
    const auto row = static_cast<std::size_t>(image.row[i]);
    known.push_back(static_cast<std::int32_t>(numbers.next(3) % geometry.turn));
    const CloudPlace place = place_of(geometry, geometry.rows[row], std::max(ranges[i], 1u), known.back());
    const std::array<double, 3> told = {place.x, place.y, place.z};
    bool finite = true;
    for (std::size_t axis = 0; axis < 3; ++axis) {
      const float near = from_ordered(ordered(static_cast<float>(told[axis])) + numbers.next(1) % 5 - 2);
      xyz[axis].push_back((kind & 1u) != 0 ? numbers.any() : near);
      finite = finite && std::isfinite(xyz[axis].back());
    }
    returned.push_back(finite && numbers.next(1) % 8 != 0 ? 1 : 0);
  }
  GivenPositions given;
  for (std::size_t axis = 0; axis < 3; ++axis) given.xyz[axis] = xyz[axis];
  given.returned = returned;
  if ((kind & 2u) != 0) given.n = ranges;
  if ((kind & 4u) != 0) given.k = known;
  if ((kind & 8u) != 0 && points > 0)
    given.none = {std::bit_cast<std::uint32_t>(xyz[0][0]), std::bit_cast<std::uint32_t>(xyz[1][0]),
                  std::bit_cast<std::uint32_t>(xyz[2][0])};
  given.by_column = (kind & 16u) != 0;
  given.bound_m = unit.form == LeftForm::Metres ? unit.unit * 0.88 : 0;
  CodedPositions coded = encode_positions(image.cells(), geometry, unit, given);
  if ((kind & 32u) != 0) {
    coded.bytes[numbers.next(2) % coded.bytes.size()] ^= static_cast<std::uint8_t>(1u + numbers.next(1));
    if ((kind & 64u) != 0) coded.bytes.resize(numbers.next(2) % (coded.bytes.size() + 1));
    decode_any(coded.bytes, image, geometry, unit, coded.n);
    return;
  }
  const DecodedPositions found =
      decode_positions(Bytes(coded.bytes.data(), coded.bytes.size()), image.cells(), geometry, unit, coded.n);
  for (std::size_t i = 0; i < points; ++i) {
    if (coded.n[i] > kMostRange || (coded.n[i] == 0) != (coded.states[i] == PointState::Empty)) std::abort();
    if (coded.states[i] != PointState::Coded) continue;
    double off = 0;
    for (std::size_t axis = 0; axis < 3; ++axis) {
      const float one = xyz[axis][i], other = found.xyz[axis][i];
      if (unit.form != LeftForm::Metres && !same_bits(one, other)) std::abort();
      off += (static_cast<double>(one) - other) * (static_cast<double>(one) - other);
    }
    if (unit.form == LeftForm::Metres && !(off <= given.bound_m * given.bound_m)) std::abort();
    if (found.k[i] != coded.k[i]) std::abort();
  }
}

void check_rests(const Image& image, Numbers& numbers, const Bytes8& rest, std::uint8_t kind) {
  try {
    for (const std::uint32_t one : decode_field_rests(Bytes(rest.data(), rest.size()), image.cells()))
      if (one > kMostRest) std::abort();
  } catch (const Error&) {
  }
  std::vector<std::uint32_t> rests(image.row.size());
  for (std::uint32_t& one : rests) one = numbers.next(1 + kind % 4) & kMostRest;
  Bytes8 coded = encode_field_rests(image.cells(), rests);
  if (decode_field_rests(Bytes(coded.data(), coded.size()), image.cells()) != rests) std::abort();
  coded[numbers.next(2) % coded.size()] ^= static_cast<std::uint8_t>(1u + numbers.next(1));
  try {
    decode_field_rests(Bytes(coded.data(), coded.size()), image.cells());
  } catch (const Error&) {
  }
}

// A number of less than 2^60 in magnitude, mostly a small one.
std::int64_t number_of(Numbers& numbers, std::uint8_t kind) {
  const std::uint64_t wide = std::uint64_t{numbers.next(4)} << 29 | numbers.next(4) % (1u << 29);
  const auto found = static_cast<std::int64_t>((kind & 1u) != 0 ? wide % ((1u << 30) + (kind & 2u)) : wide >> 1);
  return (kind & 4u) != 0 ? -found : found;
}

void check_sums(const Image& image, Numbers& numbers, const Bytes8& rest, std::uint8_t kind) {
  std::vector<std::int64_t> by_row(image.rows), by_column(image.columns), values(image.row.size());
  for (std::int64_t& one : by_row) one = number_of(numbers, kind);
  for (std::int64_t& one : by_column) one = number_of(numbers, kind);
  try {
    numbers_of_sums(image.cells(), by_column, by_row, Bytes(rest.data(), rest.size()));
  } catch (const Error&) {
  }
  try {
    times_of_sums(image.cells(), by_column, by_row, Bytes(rest.data(), rest.size()));
  } catch (const Error&) {
  }
  for (std::size_t i = 0; i < values.size(); ++i)
    values[i] = (kind & 8u) != 0 ? number_of(numbers, kind)
                                 : by_column[static_cast<std::size_t>(image.column[i])] +
                                       by_row[static_cast<std::size_t>(image.row[i])] + numbers.next(1) % 9;
  for (std::int64_t& one : values) one = std::clamp<std::int64_t>(one, -(1LL << 60) + 1, (1LL << 60) - 1);
  if (const std::optional<FieldSums> sums = sums_of(image.cells(), values, by_row)) {
    const Bytes left(sums->left.data(), sums->left.size());
    if (numbers_of_sums(image.cells(), sums->by_column, by_row, left) != values) std::abort();
  }
}

void check_times(const Image& image, Numbers& numbers, std::uint8_t kind) {
  std::vector<std::int64_t> by_row(image.rows);
  for (std::int64_t& one : by_row) one = number_of(numbers, kind) % 1'000'000'000;
  std::vector<float> times(image.row.size());
  for (float& one : times) one = (kind & 16u) != 0 ? numbers.any() : static_cast<float>(numbers.next(3)) * 1e-6F;
  const std::optional<FieldSums> sums = sums_of(image.cells(), times, by_row);
  if (!sums) return;
  const std::vector<float> found =
      times_of_sums(image.cells(), sums->by_column, by_row, Bytes(sums->left.data(), sums->left.size()));
  for (std::size_t i = 0; i < times.size(); ++i)
    if (!same_bits(times[i], found[i])) std::abort();
}

// Rings in the order of firing, of any points.
void check_firing(Numbers& numbers, std::size_t rings) {
  std::vector<std::int64_t> rank(rings), ring(numbers.next(1));
  std::vector<double> turned(rings);
  for (std::size_t i = 0; i < rings; ++i) rank[i] = static_cast<std::int64_t>(rings - 1 - i);
  for (double& one : turned) one = numbers.any();
  std::vector<float> x(ring.size()), y(ring.size());
  std::vector<std::uint8_t> returned(ring.size());
  for (std::size_t i = 0; i < ring.size(); ++i) {
    ring[i] = numbers.next(1) % static_cast<std::uint32_t>(rings + (numbers.next(1) == 0));
    x[i] = numbers.any();
    y[i] = numbers.any();
    returned[i] = static_cast<std::uint8_t>(numbers.next(1) % 2);
  }
  try {
    const std::vector<std::int64_t> column = columns_of_firing({rank, turned, numbers.any()}, ring, x, y, returned);
    for (std::size_t i = 1; i < column.size(); ++i)
      if (column[i] < column[i - 1] || column[i] > column[i - 1] + 1) std::abort();
  } catch (const Error&) {
  }
}

// Fields of points anywhere within their step, overlapping ones too.
void check_fields(Numbers& numbers) {
  const std::size_t points = numbers.next(2) % 1100, step = 1 + numbers.next(1) % 40;
  std::vector<Bytes8> values;
  std::vector<PointField> fields;
  for (std::uint32_t left = numbers.next(1) % 5; left > 0; --left) {
    const std::size_t bytes = std::size_t{1} << numbers.next(1) % 4;
    if (bytes > step) continue;
    values.emplace_back(bytes * points, static_cast<std::uint8_t>(numbers.next(1)));
    fields.push_back({values.back().data(), bytes, numbers.next(1) % (step - bytes + 1)});
  }
  Bytes8 out(points * step);
  put_fields(fields, points, step, numbers.next(1) % 2 != 0, out.data());
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  FuzzInput input(data, size);
  const std::uint8_t part = input.byte() % 6, kind = input.byte();
  const Image image = image_of(input);
  const std::uint8_t ranges = input.byte();
  FuzzInput ahead = input;  // the geometry takes two bytes; numbers are made of those behind it
  ahead.byte();
  ahead.byte();
  const Bytes8 rest = ahead.rest();
  Numbers numbers(rest);
  LeftUnit unit;
  const CloudGeometry geometry = geometry_of(input, numbers, image.rows, unit);
  if (part == 0) decode_any(rest, image, geometry, unit, ranges_of(numbers, image.row.size(), ranges));
  if (part == 1) check_positions(image, geometry, unit, numbers, kind);
  if (part == 2) check_rests(image, numbers, rest, kind);
  if (part == 3) check_sums(image, numbers, rest, kind);
  if (part == 4) check_times(image, numbers, kind);
  if (part == 5) {
    check_firing(numbers, image.rows);
    check_fields(numbers);
  }
  return 0;
}
