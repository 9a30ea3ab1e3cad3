#include <nanobind/stl/optional.h>

#include <algorithm>
#include <optional>

#include "bindings.hpp"
#include "clouds/columns.hpp"
#include "clouds/points.hpp"

namespace {

using namespace lidarcodec;

template <typename T>
std::span<const T> span_of(const In<T, 1>& values) {
  return {values.data(), values.size()};
}

// rows, columns, and row and column of each point
using GivenCells = nb::typed<nb::tuple, nb::int_, nb::int_, Array<std::int64_t>, Array<std::int64_t>>;
// step in metres, steps of a turn, narrow, angles, values of rows (6, H) float64; form and unit of what is left
using GivenGeometry =
    nb::typed<nb::tuple, nb::float_, nb::int_, nb::bool_, nb::int_, Array<double>, nb::int_, nb::float_>;

// Holds the arrays as long as the cells are used.
struct Cells {
  In<std::int64_t, 1> row, column;
  CloudCells cells;

  explicit Cells(const GivenCells& given)
      : row(nb::cast<In<std::int64_t, 1>>(given[2], false)), column(nb::cast<In<std::int64_t, 1>>(given[3], false)) {
    cells = {nb::cast<std::size_t>(given[0]), nb::cast<std::size_t>(given[1]), span_of(row), span_of(column)};
  }
};

struct Geometry {
  CloudGeometry geometry;
  LeftUnit unit;

  explicit Geometry(const GivenGeometry& given) {
    geometry.step_m = nb::cast<double>(given[0]);
    geometry.turn = nb::cast<std::uint32_t>(given[1]);
    geometry.narrow = nb::cast<bool>(given[2]);
    geometry.angles = nb::cast<std::uint8_t>(given[3]);
    const auto rows = nb::cast<In<double, 2>>(given[4], false);
    const auto form = nb::cast<std::uint8_t>(given[5]);
    if (rows.shape(0) != 6 || geometry.angles >= kAngleForms.size() || form > 2 || geometry.turn == 0)
      throw Error(ErrorCode::Section, "a geometry of unknown form");
    const std::size_t count = rows.shape(1);
    for (std::size_t i = 0; i < count; ++i) {
      const auto value = [&](std::size_t place) { return rows.data()[place * count + i]; };
      geometry.rows.push_back({value(0), value(1), value(2), value(3), value(4), value(5)});
    }
    unit = {static_cast<LeftForm>(form), nb::cast<double>(given[6])};
  }
};

using Coded = Tuple<nb::bytes, Array<std::uint8_t>, Array<std::uint32_t>, Array<std::int32_t>, double, bool>;

Coded encode(const In<float, 2>& xyz, const In<std::uint8_t, 1>& returned, const GivenCells& given_cells,
             const GivenGeometry& given_geometry, const std::optional<In<std::uint32_t, 1>>& n,
             const std::optional<In<std::int32_t, 1>>& k, const std::optional<In<std::uint32_t, 1>>& none,
             double bound_m, bool by_column) {
  const Cells cells(given_cells);
  const Geometry geometry(given_geometry);
  const std::size_t points = xyz.shape(1);
  if (xyz.shape(0) != 3 || (none && none->size() != 3))
    throw Error(ErrorCode::Section, "coordinates are (3, N), and bits of a point without a return (3,)");
  GivenPositions given;
  for (std::size_t axis = 0; axis < 3; ++axis) given.xyz[axis] = {xyz.data() + axis * points, points};
  given.returned = span_of(returned);
  if (n) given.n = span_of(*n);
  if (k) given.k = span_of(*k);
  if (none) given.none = {none->data()[0], none->data()[1], none->data()[2]};
  given.bound_m = bound_m;
  given.by_column = by_column;
  CodedPositions coded;
  std::vector<std::uint8_t> states;
  {
    nb::gil_scoped_release release;
    coded = encode_positions(cells.cells, geometry.geometry, geometry.unit, given);
    for (const PointState state : coded.states) states.push_back(static_cast<std::uint8_t>(state));
  }
  return Coded(nb::make_tuple(give_bytes(coded.bytes), give(std::move(states), {points}),
                              give(std::move(coded.n), {points}), give(std::move(coded.k), {points}), coded.bits,
                              coded.by_column));
}

Tuple<Array<float>, Array<std::int32_t>> decode(const nb::bytes& data, const GivenCells& given_cells,
                                                const GivenGeometry& given_geometry, const In<std::uint32_t, 1>& n) {
  const Cells cells(given_cells);
  const Geometry geometry(given_geometry);
  const Bytes bytes{data_of(data), data.size()};
  const std::size_t points = n.size();
  DecodedPositions found;
  std::vector<float> xyz;
  {
    nb::gil_scoped_release release;
    found = decode_positions(bytes, cells.cells, geometry.geometry, geometry.unit, span_of(n));
    xyz.reserve(3 * points);
    for (const std::vector<float>& axis : found.xyz) xyz.insert(xyz.end(), axis.begin(), axis.end());
  }
  return {nb::make_tuple(give(std::move(xyz), {3, points}), give(std::move(found.k), {points}))};
}

using GivenSums = Tuple<Array<std::int64_t>, nb::bytes, std::size_t>;

template <typename T>
std::optional<GivenSums> encode_sums(const GivenCells& given, const In<T, 1>& values,
                                     const In<std::int64_t, 1>& by_row) {
  const Cells cells(given);
  std::optional<FieldSums> sums;
  {
    nb::gil_scoped_release release;
    sums = sums_of(cells.cells, span_of(values), span_of(by_row));
  }
  if (!sums) return std::nullopt;
  const std::size_t columns = sums->by_column.size();
  return GivenSums(nb::make_tuple(give(std::move(sums->by_column), {columns}), give_bytes(sums->left), sums->not_told));
}

template <typename T, auto kOf>
Array<T> decode_sums(const nb::bytes& left, const GivenCells& given, const In<std::int64_t, 1>& by_column,
                     const In<std::int64_t, 1>& by_row) {
  const Cells cells(given);
  const Bytes bytes{data_of(left), left.size()};
  std::vector<T> values;
  {
    nb::gil_scoped_release release;
    values = kOf(cells.cells, span_of(by_column), span_of(by_row), bytes);
  }
  const std::size_t points = values.size();
  return give(std::move(values), {points});
}

// first byte in a point, and N values
using GivenField = nb::typed<nb::tuple, nb::int_, nb::object>;
using AnyValues = nb::ndarray<nb::ro, nb::ndim<1>, nb::c_contig, nb::device::cpu>;

nb::bytes message_of(const nb::bytes& head, const nb::bytes& tail, std::size_t points, std::size_t step,
                     bool big_endian, const List<GivenField>& given) {
  constexpr std::size_t kMost = std::size_t{1} << 26;
  if (step > kMost || points > kMost || step * points > kMost)
    throw Error(ErrorCode::Section, "points of more bytes than a message may have");
  std::vector<AnyValues> arrays;
  std::vector<PointField> fields;
  for (const nb::handle each : given) {
    const auto field = nb::cast<nb::tuple>(each);
    const auto at = nb::cast<std::size_t>(field[0]);
    arrays.push_back(nb::cast<AnyValues>(field[1], false));
    const AnyValues& values = arrays.back();
    const std::size_t bytes = values.itemsize();
    if (values.size() != points || at > step || bytes > step - at)
      throw Error(ErrorCode::Section, "a field that does not lie within its point, or not of each");
    fields.push_back({static_cast<const std::uint8_t*>(values.data()), bytes, at});
  }
  const std::size_t size = points * step;
  nb::bytes made = nb::steal<nb::bytes>(
      PyBytes_FromStringAndSize(nullptr, static_cast<Py_ssize_t>(head.size() + size + tail.size())));
  if (!made.is_valid()) nb::raise_python_error();
  auto* const out = reinterpret_cast<std::uint8_t*>(PyBytes_AsString(made.ptr()));
  const std::uint8_t *const before = data_of(head), *const behind = data_of(tail);
  const std::size_t head_bytes = head.size(), tail_bytes = tail.size();
  {
    nb::gil_scoped_release release;
    std::copy_n(before, head_bytes, out);
    std::fill_n(out + head_bytes, size, std::uint8_t{0});
    put_fields(fields, points, step, big_endian, out + head_bytes);
    std::copy_n(behind, tail_bytes, out + head_bytes + size);
  }
  return made;
}

using Order = nb::typed<nb::tuple, nb::int_, nb::int_, nb::bool_, Array<std::int64_t>>;
using AnyImage = nb::ndarray<nb::ro, nb::ndim<2>, nb::c_contig, nb::device::cpu>;

std::vector<std::uint32_t> numbers_at(const PointCells& cells, std::size_t columns, const AnyImage& image) {
  if (image.dtype() == nb::dtype<std::uint8_t>())
    return at_points(cells, columns, static_cast<const std::uint8_t*>(image.data()));
  if (image.dtype() == nb::dtype<std::uint16_t>())
    return at_points(cells, columns, static_cast<const std::uint16_t*>(image.data()));
  return at_points(cells, columns, static_cast<const std::uint32_t*>(image.data()));
}

Tuple<Array<std::int64_t>, Array<std::int64_t>, List<Array<std::uint32_t>>> points_of_images(
    const Order& given, bool full, const List<nb::object>& images) {
  PointOrder order;
  order.rows = nb::cast<std::size_t>(given[0]);
  order.columns = nb::cast<std::size_t>(given[1]);
  order.by_column = nb::cast<bool>(given[2]);
  const auto firing = nb::cast<In<std::int64_t, 1>>(given[3], false);
  order.firing = span_of(firing);
  std::vector<AnyImage> planes;
  for (const nb::handle each : images) {
    planes.push_back(nb::cast<AnyImage>(each, false));
    const AnyImage& plane = planes.back();
    const bool known = plane.dtype() == nb::dtype<std::uint8_t>() || plane.dtype() == nb::dtype<std::uint16_t>() ||
                       plane.dtype() == nb::dtype<std::uint32_t>();
    if (!known || plane.shape(0) != order.rows || plane.shape(1) != order.columns)
      throw Error(ErrorCode::Section, "images that are not of one shape, or not of whole numbers");
  }
  const bool fires = std::all_of(order.firing.begin(), order.firing.end(), [&](std::int64_t row) {
    return row >= 0 && row < static_cast<std::int64_t>(order.rows);
  });
  if (planes.empty() || !fires || order.firing.size() != order.rows)
    throw Error(ErrorCode::Section, "the order of firing is damaged, or there are no images");
  PointCells cells;
  std::vector<std::vector<std::uint32_t>> numbers;
  {
    nb::gil_scoped_release release;
    std::vector<std::uint32_t> ranges;
    if (!full) {
      ranges.resize(order.rows * order.columns);
      const AnyImage& first = planes[0];
      const auto take = [&](const auto* values) { std::copy_n(values, ranges.size(), ranges.begin()); };
      if (first.itemsize() == 1)
        take(static_cast<const std::uint8_t*>(first.data()));
      else if (first.itemsize() == 2)
        take(static_cast<const std::uint16_t*>(first.data()));
      else
        take(static_cast<const std::uint32_t*>(first.data()));
      order.ranges = ranges;
    }
    cells = cells_of_points(order);
    for (const AnyImage& plane : planes) numbers.push_back(numbers_at(cells, order.columns, plane));
  }
  const std::size_t points = cells.row.size();
  nb::list found;
  for (std::vector<std::uint32_t>& one : numbers) found.append(give(std::move(one), {points}));
  return {nb::make_tuple(give(std::move(cells.row), {points}), give(std::move(cells.column), {points}), found)};
}

}  // namespace

void bind_clouds(nb::module_& m) {
  m.def("encode_points", &encode, nb::arg("xyz").noconvert(), nb::arg("returned").noconvert(), nb::arg("cells"),
        nb::arg("geometry"), nb::arg("n").noconvert().none(), nb::arg("k").noconvert().none(),
        nb::arg("none").noconvert().none(), nb::arg("bound_m"), nb::arg("by_column"),
        "Bytes of the coordinates of points, (3, N); of each point whether it is coded (0), apart (1) or has no return "
        "(2), (N,); its range n and direction k, (N,), bits of a point, roughly, and whether directions are told by "
        "columns. cells: rows, columns, row (N,), "
        "column (N,); geometry: range step in metres, steps of a turn, narrow, angles, values of rows (6, H), form and "
        "unit of what is left; none: bits of points without a return.");
  m.def("decode_points", &decode, nb::arg("data"), nb::arg("cells"), nb::arg("geometry"), nb::arg("n").noconvert(),
        "Coordinates (3, N) and directions (N,). Raises DecodeError.");
  m.def(
      "encode_field_rests",
      [](const GivenCells& given, const In<std::uint32_t, 1>& rests) {
        const Cells cells(given);
        std::vector<std::uint8_t> data;
        {
          nb::gil_scoped_release release;
          data = encode_field_rests(cells.cells, span_of(rests));
        }
        return give_bytes(data);
      },
      nb::arg("cells"), nb::arg("rests").noconvert(), "Bytes of rests (N,), each less than 2^28.");
  m.def(
      "decode_field_rests",
      [](const nb::bytes& data, const GivenCells& given) -> Array<std::uint32_t> {
        const Cells cells(given);
        const Bytes bytes{data_of(data), data.size()};
        const std::size_t points = cells.row.size();
        std::vector<std::uint32_t> rests;
        {
          nb::gil_scoped_release release;
          rests = decode_field_rests(bytes, cells.cells);
        }
        return give(std::move(rests), {points});
      },
      nb::arg("data"), nb::arg("cells"), "The rests, (N,). Raises DecodeError.");
  m.def("encode_sums", &encode_sums<std::int64_t>, nb::arg("cells"), nb::arg("numbers").noconvert(),
        nb::arg("by_row").noconvert(),
        "Numbers of columns (W,), bytes of what is left of numbers (N,), and how many have something left; None if "
        "that is too much. by_row: (H,). All less than 2^61 in magnitude.");
  m.def("encode_times", &encode_sums<float>, nb::arg("cells"), nb::arg("times").noconvert(),
        nb::arg("by_row").noconvert(),
        "The same of times in seconds; numbers of columns and rows are in units of 1e-9.");
  m.def("decode_sums", &decode_sums<std::int64_t, &numbers_of_sums>, nb::arg("left"), nb::arg("cells"),
        nb::arg("by_column").noconvert(), nb::arg("by_row").noconvert(), "The numbers, (N,). Raises DecodeError.");
  m.def("decode_times", &decode_sums<float, &times_of_sums>, nb::arg("left"), nb::arg("cells"),
        nb::arg("by_column").noconvert(), nb::arg("by_row").noconvert(), "The times, (N,). Raises DecodeError.");
  m.def("message_of_points", &message_of, nb::arg("head"), nb::arg("tail"), nb::arg("points"), nb::arg("step"),
        nb::arg("big_endian"), nb::arg("fields"),
        "Bytes between a head and a tail: points of `step` bytes, 0 where there is no field. fields: the first byte of "
        "each, and its values (N,) in the machine's byte order.");
  m.def("points_of_images", &points_of_images, nb::arg("order"), nb::arg("full"), nb::arg("images"),
        "Row and column (N,) of each point, and the numbers of images (H, W), of 8, 16 or 32 bits without sign, at the "
        "points. order: H, W, whether points come column by column, and the order of rows in a column (H,); full: each "
        "cell has a point, else those where the first image is not 0.");
  m.def(
      "columns_of_firing",
      [](const In<std::int64_t, 1>& rank, const In<double, 1>& turned, double jump, const In<std::int64_t, 1>& ring,
         const In<float, 1>& x, const In<float, 1>& y, const In<std::uint8_t, 1>& returned) -> Array<std::int64_t> {
        std::vector<std::int64_t> columns;
        {
          nb::gil_scoped_release release;
          columns = columns_of_firing({span_of(rank), span_of(turned), jump}, span_of(ring), span_of(x), span_of(y),
                                      span_of(returned));
        }
        const std::size_t points = columns.size();
        return give(std::move(columns), {points});
      },
      nb::arg("rank").noconvert(), nb::arg("turned").noconvert(), nb::arg("jump"), nb::arg("ring").noconvert(),
      nb::arg("x").noconvert(), nb::arg("y").noconvert(), nb::arg("returned").noconvert(),
      "(N,) column of each point. rank (H,): of each ring in the order of firing; turned (H,): its direction, radians; "
      "jump: radians; a point as far from the one before begins a column.");
}
