#include "session/frames/plane_section.hpp"

#include <algorithm>
#include <numeric>

#include "base/varint.hpp"
#include "images/coder.hpp"
#include "images/following.hpp"
#include "session/frames/names.hpp"

namespace lidarcodec {
namespace {

constexpr std::uint8_t kPlain = 0, kZstd = 1, kModelled = 2, kFollowing = 3, kReduced = 64, kWithTables = 128;
constexpr std::uint64_t kMostTableSize = 256, kMostTableStep = 1 << 20;
constexpr std::uint32_t kPlaceBits = 8;
constexpr std::size_t kMostRows = 128, kMostFramePlanes = 12, kMostNumbers = std::size_t{5} << 20, kMostName = 16;
constexpr std::uint32_t kMostStep = 40'001;

[[noreturn]] void damaged(const std::string& what) { throw Error(ErrorCode::Section, what); }

NamedPlane read_form(VarintReader& reader) {
  NamedPlane plane;
  const std::uint8_t role = reader.byte();
  plane.bits = reader.byte();
  plane.of = reader.byte();
  const Bytes name = reader.take(reader.number(kMostName, 1));
  if (role > static_cast<std::uint8_t>(PlaneRole::Attribute) || plane.bits < 1 || plane.bits > kMostPlaneBits)
    damaged("a plane of unknown role " + std::to_string(role) + ", or of " + std::to_string(plane.bits) + " bits");
  if (!is_plain_name(name)) damaged("a plane's name that is not of letters, digits and underscores");
  plane.role = static_cast<PlaneRole>(role);
  plane.name.assign(name.begin(), name.end());
  return plane;
}

void check_forms(const std::vector<NamedPlane>& planes) {
  for (std::size_t i = 0; i < planes.size(); ++i) {
    const NamedPlane& plane = planes[i];
    if (plane.of >= planes.size() ||
        (plane.role == PlaneRole::Attribute && planes[plane.of].role == PlaneRole::Attribute))
      damaged("plane " + plane.name + " belongs to plane " + std::to_string(plane.of) + ", which is not one of ranges");
    for (std::size_t j = 0; j < i; ++j)
      if (planes[j].name == plane.name) damaged("planes whose names occur twice");
  }
  if (planes[0].name != "range" || planes[0].role != PlaneRole::Range) damaged("planes whose first is not the ranges");
}

// In the order in which they are coded: ranges first, then narrow attributes.
PlaneFrame frame_of(const std::vector<NamedPlane>& planes, const std::vector<std::size_t>& order) {
  std::vector<std::size_t> number(planes.size());
  for (std::size_t i = 0; i < order.size(); ++i) number[order[i]] = i;
  PlaneFrame frame;
  for (std::size_t i = 0; i < order.size(); ++i) {
    const NamedPlane& plane = planes[order[i]];
    PlaneForm form{plane.role, plane.bits, plane.role == PlaneRole::Attribute ? number[plane.of] : i, i};
    const bool second = plane.name.ends_with('2');
    for (std::size_t like = 0; second && plane.role != PlaneRole::Range && like < i; ++like) {
      const NamedPlane& other = planes[order[like]];
      if (other.name == plane.name.substr(0, plane.name.size() - 1) && other.bits == plane.bits &&
          (other.role == PlaneRole::Attribute) == (plane.role == PlaneRole::Attribute))
        form.like = like;
    }
    frame.planes.push_back(form);
  }
  return frame;
}

// memory: of the frames before, or nothing where this frame stands for itself
void decode_modelled(Bytes body, PlaneFrame shape, std::vector<NamedPlane>& planes, PlaneMemory* memory) {
  std::vector<std::size_t> order(planes.size());
  std::iota(order.begin(), order.end(), std::size_t{0});
  std::stable_sort(order.begin(), order.end(), [&](std::size_t a, std::size_t b) {
    return std::pair(planes[a].role, planes[a].bits) < std::pair(planes[b].role, planes[b].bits);
  });
  shape.planes = frame_of(planes, order).planes;
  std::vector<PlaneImage> images;
  try {
    images = memory == nullptr ? decode_planes(body.data(), body.size(), shape)
                               : decode_next_planes(*memory, body.data(), body.size(), shape);
  } catch (const Error& error) {
    if (error.code() == ErrorCode::Settings) damaged(error.what());
    throw;
  }
  for (std::size_t i = 0; i < order.size(); ++i) planes[order[i]].values = std::move(images[i]);
}

template <std::size_t kBytes>
PlaneImage numbers_of(const std::uint8_t* data, std::size_t cells) {
  PlaneImage values(cells);
  for (std::size_t i = 0; i < cells; ++i) {
    std::uint32_t value = 0;
    for (std::size_t byte = 0; byte < kBytes; ++byte) value |= std::uint32_t{data[i * kBytes + byte]} << (8 * byte);
    values[i] = value;
  }
  return values;
}

// Numbers of `bytes` bytes each, little endian.
PlaneImage plain_numbers(const std::uint8_t* data, std::size_t cells, std::size_t bytes) {
  return bytes == 1 ? numbers_of<1>(data, cells) : bytes == 2 ? numbers_of<2>(data, cells) : numbers_of<4>(data, cells);
}

// Sums along rows of differences, whose lowest bytes come first; modulo what so many bytes hold.
PlaneImage summed_numbers(const std::uint8_t* data, std::size_t rows, std::size_t columns, std::size_t bytes) {
  const std::size_t cells = rows * columns;
  const std::uint32_t mask = bytes == 4 ? ~std::uint32_t{0} : (std::uint32_t{1} << (8 * bytes)) - 1;
  PlaneImage values(cells);
  for (std::size_t byte = 0; byte < bytes; ++byte)
    for (std::size_t i = 0; i < cells; ++i) values[i] |= std::uint32_t{data[byte * cells + i]} << (8 * byte);
  for (std::size_t row = 0; row < rows; ++row) {
    std::uint32_t* const of = values.data() + row * columns;
    for (std::size_t column = 1; column < columns; ++column) of[column] = (of[column] + of[column - 1]) & mask;
  }
  return values;
}

// Numbers become values: of ranges in steps, of all others what they are.
void scale(NamedPlane& plane, std::uint32_t step) {
  const std::uint32_t most = (std::uint32_t{1} << plane.bits) - 1;
  if (plane.role != PlaneRole::Attribute && step > 1) {
    const RangeSteps steps(step, plane.bits);
    for (std::uint32_t& value : plane.values) value = steps.range(value);
  } else if (std::any_of(plane.values.begin(), plane.values.end(), [&](std::uint32_t value) { return value > most; })) {
    damaged("plane " + plane.name + " holds a number of more than " + std::to_string(plane.bits) + " bits");
  }
}

// Values of planes that are sent as places in a table, ascending; empty for a plane without one.
using Tables = std::vector<std::vector<std::uint32_t>>;

Tables read_tables(VarintReader& reader, const std::vector<NamedPlane>& planes) {
  std::vector<std::vector<std::uint32_t>> tables(reader.number(planes.size(), 1));
  for (std::vector<std::uint32_t>& table : tables) {
    std::uint32_t value = 0;
    for (std::uint64_t left = reader.number(kMostTableSize, 1); left > 0; --left) {
      const std::uint64_t step = reader.number(kMostTableStep);
      if (step == 0 && !table.empty()) damaged("a table of values that do not ascend");
      value += static_cast<std::uint32_t>(step);
      table.push_back(value);
    }
  }
  Tables of_plane;
  for (const NamedPlane& plane : planes) {
    const std::uint8_t number = reader.byte();
    if (number == 0) {
      of_plane.emplace_back();
      continue;
    }
    if (number > tables.size() || plane.role != PlaneRole::Attribute)
      damaged("plane " + plane.name + " with table " + std::to_string(number) + " of " + std::to_string(tables.size()) +
              ", or not an attribute");
    const std::vector<std::uint32_t>& table = tables[number - 1u];
    if (table.back() >> plane.bits != 0)
      damaged("plane " + plane.name + " has " + std::to_string(plane.bits) + " bits, but its table holds " +
              std::to_string(table.back()));
    of_plane.push_back(table);
  }
  return of_plane;
}

// Places become values, where the range plane has a return.
void look_up(const Tables& tables, std::vector<NamedPlane>& planes) {
  for (std::size_t i = 0; i < tables.size(); ++i) {
    const std::vector<std::uint32_t>& table = tables[i];
    if (table.empty()) continue;
    const PlaneImage& ranges = planes[planes[i].of].values;
    PlaneImage& values = planes[i].values;
    for (std::size_t cell = 0; cell < values.size(); ++cell) {
      if (ranges[cell] != 0 && values[cell] >= table.size())
        damaged("plane " + planes[i].name + " holds places beyond its " + std::to_string(table.size()) + " values");
      values[cell] = ranges[cell] == 0 ? 0 : table[values[cell]];
    }
  }
}

// The planes of a body, of `columns` columns, as they are coded: of those with a table, places.
void decode_body(std::uint8_t kind, Bytes body, PlaneFrame shape, std::vector<NamedPlane>& planes,
                 const Outside& outside, PlaneMemory* memory) {
  if (kind >= kModelled) return decode_modelled(body, std::move(shape), planes, kind == kFollowing ? memory : nullptr);
  const std::size_t cells = shape.rows * shape.columns;
  std::size_t size = 0;
  for (const NamedPlane& plane : planes) size += cells * plane_bytes(plane.bits);
  std::vector<std::uint8_t> opened;
  if (kind == kZstd) body = opened = zstd_frame(outside, body, size);
  if (body.size() != size)
    damaged("planes of " + std::to_string(body.size()) + " bytes where " + std::to_string(size) + " are expected");
  for (NamedPlane& plane : planes) {
    const std::size_t bytes = plane_bytes(plane.bits);
    plane.values = kind == kPlain ? plain_numbers(body.data(), cells, bytes)
                                  : summed_numbers(body.data(), shape.rows, shape.columns, bytes);
    scale(plane, shape.step);
    body = body.subspan(cells * bytes);
  }
}

}  // namespace

std::shared_ptr<PlaneMemory> empty_plane_memory() { return std::make_shared<PlaneMemory>(); }

PlaneSection decode_plane_section(Bytes data, std::size_t columns, const Outside& outside, PlaneMemory* memory) {
  VarintReader reader(data, "planes");
  const std::uint8_t marks = reader.byte();
  const auto kind = static_cast<std::uint8_t>(marks & ~(kReduced | kWithTables));
  PlaneSection section;
  section.rows = std::size_t{reader.byte()} + 1;
  const auto step = static_cast<std::uint32_t>(reader.number(kMostStep, 1));
  const std::size_t count = reader.number(kMostFramePlanes, 1);
  if (kind > kFollowing) damaged("planes of unknown kind " + std::to_string(kind));
  PlaneMemory alone;
  if (memory == nullptr) memory = &alone;
  if (section.rows > kMostRows || columns > kMostColumns || section.rows * columns * count > kMostNumbers)
    damaged(std::to_string(count) + " planes of " + std::to_string(section.rows) + " x " + std::to_string(columns) +
            ": the limit is " + std::to_string(kMostNumbers) + " numbers in a frame");
  if (step % 2 == 0) damaged("range step " + std::to_string(step) + " is not an odd number");
  while (section.planes.size() < count) section.planes.push_back(read_form(reader));
  check_forms(section.planes);
  PlaneFrame shape;
  shape.rows = section.rows;
  shape.columns = columns;
  shape.step = step;
  for (std::size_t row = 0; row < section.rows; ++row)
    shape.shift.push_back(static_cast<std::int32_t>(reader.signed_number(kMostColumns)));
  section.shift = shape.shift;

  const Tables tables = (marks & kWithTables) != 0 ? read_tables(reader, section.planes) : Tables();
  std::vector<std::uint32_t> bits;
  for (std::size_t i = 0; i < count; ++i) {
    bits.push_back(section.planes[i].bits);
    if (!tables.empty() && !tables[i].empty()) section.planes[i].bits = kPlaceBits;
  }
  decode_body(kind, reader.rest(), std::move(shape), section.planes, outside, memory);
  for (std::size_t i = 0; i < count; ++i) {
    NamedPlane& plane = section.planes[i];
    plane.bits = bits[i];
    const std::uint32_t most = (std::uint32_t{1} << plane.bits) - 1;
    if (plane.role != PlaneRole::Attribute && step > 1)
      for (std::uint32_t& value : plane.values) value = std::min(value, most);  // a step may be too large for the plane
  }
  look_up(tables, section.planes);
  return section;
}

}  // namespace lidarcodec
