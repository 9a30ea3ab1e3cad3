#include "session/frames/cloud_columns.hpp"

#include <algorithm>
#include <limits>

#include "clouds/rest_tables.hpp"
#include "session/frames/rest.hpp"

namespace lidarcodec {
namespace {

constexpr std::uint32_t kMostRepeated = 16;
constexpr std::int64_t kWidest = std::int64_t{1} << 60;

enum class Way : std::uint8_t { Bytes, Constant, Row, Range, Metres, Plane, Whole, ByRow, Sums, Times, Angle, Steps };

using Numbers = std::vector<std::int64_t>;

[[noreturn]] void damaged(const std::string& what) { throw Error(ErrorCode::Section, what); }

std::int64_t sum(std::int64_t a, std::int64_t b) {
  return static_cast<std::int64_t>(static_cast<std::uint64_t>(a) + static_cast<std::uint64_t>(b));
}

std::uint64_t bits_of(float value) { return std::bit_cast<std::uint32_t>(value); }

struct Limits {
  std::int64_t least, most;
};

template <class Number>
constexpr Limits limits() {
  return {std::numeric_limits<Number>::min(), std::numeric_limits<Number>::max()};
}

Limits limits_of(FieldType type) {
  switch (type) {
    case FieldType::Int8:
      return limits<std::int8_t>();
    case FieldType::UInt8:
      return limits<std::uint8_t>();
    case FieldType::Int16:
      return limits<std::int16_t>();
    case FieldType::UInt16:
      return limits<std::uint16_t>();
    case FieldType::UInt32:
      return limits<std::uint32_t>();
    default:
      return limits<std::int32_t>();  // a float by its place in their order
  }
}

// The numbers of one column.
class ColumnReader {
 public:
  ColumnReader(VarintReader& reader, FieldType type, const ColumnImage& image, const std::vector<std::uint32_t>* plane,
               const Outside& outside)
      : reader_(reader), type_(type), image_(image), plane_(plane), outside_(outside) {}

  std::vector<std::uint64_t> read() {
    const std::uint8_t number = reader_.byte();
    const auto way = static_cast<Way>(number);
    if (way == Way::Bytes) return plain();
    if (way == Way::Constant)
      return std::vector<std::uint64_t>(points(), little_endian(reader_.take(width()), 0, width()));
    if (width() == 8) base_ = static_cast<std::int64_t>(little_endian(reader_.take(8), 0, 8));
    if (way == Way::Steps) return steps();
    if (image_.cells == nullptr) unknown(number);
    if (way == Way::ByRow) return by_row();
    if (way == Way::Sums) return sums();
    if (width() == 8) unknown(number);
    if (way == Way::Row) return from_numbers(Numbers(image_.cells->row.begin(), image_.cells->row.end()));
    if (way == Way::Range) return from_numbers(Numbers(image_.n.begin(), image_.n.end()));
    if (way == Way::Plane) return from_numbers(Numbers(of_plane().begin(), of_plane().end()));
    if (type_ != FieldType::Float32) unknown(number);
    if (way == Way::Whole) return whole();
    if (way == Way::Times) return times();
    if (image_.geometry != nullptr && way == Way::Metres) return metres();
    if (image_.geometry != nullptr && way == Way::Angle) return angle();
    unknown(number);
  }

 private:
  std::size_t points() const { return image_.n.size(); }
  std::size_t width() const { return bytes_of(type_); }

  [[noreturn]] static void unknown(std::uint8_t way) {
    damaged("a column of a cloud coded in the way " + std::to_string(way) + ", which does not fit it");
  }

  const std::vector<std::uint32_t>& of_plane() const {
    if (plane_ == nullptr) damaged("a column of a cloud without its plane");
    return *plane_;
  }

  std::vector<std::uint64_t> from_numbers(const Numbers& numbers) const {
    std::vector<std::uint64_t> found(numbers.begin(), numbers.end());
    if (width() == 8) return found;
    const Limits limits = limits_of(type_);
    for (std::size_t i = 0; i < numbers.size(); ++i) {
      if (numbers[i] < limits.least || numbers[i] > limits.most)
        damaged("a number that does not fit a column of " + std::to_string(width()) + " bytes");
      if (type_ == FieldType::Float32) found[i] = bits_of(from_ordered(numbers[i]));
    }
    return found;
  }

  std::vector<std::uint64_t> plain() {
    const std::vector<std::uint8_t> bytes = decode_point_bytes(reader_, points(), width(), outside_);
    std::vector<std::uint64_t> found(points());
    for (std::size_t byte = 0; byte < width(); ++byte)
      for (std::size_t i = 0; i < found.size(); ++i)
        found[i] |= std::uint64_t{bytes[byte * found.size() + i]} << (8 * byte);
    return found;
  }

  std::vector<std::uint64_t> steps() {
    std::int64_t now = base_;
    Numbers numbers = signed_numbers(reader_.sized(), {points()});
    for (std::int64_t& number : numbers) number = now = sum(now, number);
    return from_numbers(numbers);
  }

  std::vector<std::uint64_t> by_row() {
    const Numbers line = read_line(reader_, image_.cells->rows);
    Numbers numbers;
    numbers.reserve(points());
    for (const std::int64_t row : image_.cells->row) numbers.push_back(sum(line[static_cast<std::size_t>(row)], base_));
    return from_numbers(numbers);
  }

  struct Lines {
    Numbers by_column, by_row;
  };
  Lines lines() {
    Lines found{read_line(reader_, image_.cells->columns), read_line(reader_, image_.cells->rows)};
    for (const Numbers* const line : {&found.by_column, &found.by_row})
      if (std::any_of(line->begin(), line->end(),
                      [](std::int64_t number) { return number <= -kWidest || number >= kWidest; }))
        damaged("a number of a column or row beyond 60 bits");
    return found;
  }

  std::vector<std::uint64_t> sums() {
    const Lines found = lines();
    Numbers numbers = numbers_of_sums(*image_.cells, found.by_column, found.by_row, reader_.sized());
    for (std::int64_t& number : numbers) number = sum(number, base_);
    return from_numbers(numbers);
  }

  std::vector<std::uint64_t> times() {
    const Lines found = lines();
    std::vector<std::uint64_t> bits;
    for (const float time : times_of_sums(*image_.cells, found.by_column, found.by_row, reader_.sized()))
      bits.push_back(bits_of(time));
    return bits;
  }

  std::vector<std::uint64_t> whole() const {
    std::vector<std::uint64_t> bits;
    for (const std::uint32_t number : of_plane()) bits.push_back(bits_of(static_cast<float>(number)));
    return bits;
  }

  std::vector<std::uint64_t> metres() const {
    const auto step = static_cast<float>(image_.geometry->step_m);
    std::vector<std::uint64_t> bits;
    for (const std::uint32_t n : image_.n) bits.push_back(bits_of(static_cast<float>(n) * step));
    return bits;
  }

  std::vector<std::uint64_t> angle() {
    const std::uint8_t sense = reader_.byte();
    if (sense < 1 || sense >= kAngleForms.size()) damaged("an angle of the unknown sense " + std::to_string(sense));
    const std::vector<std::uint32_t> rests = decode_field_rests(reader_.sized(), *image_.cells);
    const CloudGeometry& geometry = *image_.geometry;
    Numbers numbers;
    for (std::size_t i = 0; i < rests.size(); ++i) {
      const CloudRow& row = geometry.rows[static_cast<std::size_t>(image_.cells->row[i])];
      const double turns =
          driver_turns((static_cast<double>(image_.k[i]) + row.turned) / geometry.turn, kAngleForms[geometry.angles]);
      numbers.push_back(ordered(driver_radians(turns, kAngleForms[sense])) + unzigzag(rests[i]));
    }
    return from_numbers(numbers);
  }

  VarintReader& reader_;
  FieldType type_;
  const ColumnImage& image_;
  const std::vector<std::uint32_t>* plane_;
  const Outside& outside_;
  std::int64_t base_ = 0;  // is added to numbers of 8 bytes
};

}  // namespace

CloudColumns columns_of(const CloudHead& head, bool without_xyz) {
  CloudColumns found;
  std::vector<bool> free(head.point_step, true);
  for (const CloudField& field : head.fields) {
    if (field.repeated > kMostRepeated) continue;
    const bool besides = without_xyz && field.repeated == 1 && field.name.size() == 1 &&
                         (field.name == "x" || field.name == "y" || field.name == "z");
    const std::size_t bytes = bytes_of(field.type);
    for (std::size_t number = 0; number < field.repeated; ++number) {
      const std::size_t begin = field.offset + number * bytes;
      const auto first = free.begin() + static_cast<std::ptrdiff_t>(begin),
                 end = first + static_cast<std::ptrdiff_t>(bytes);
      if (std::find(first, end, false) != end) continue;
      if (!besides) found.columns.push_back({begin, field.type});
      std::fill(first, end, false);
    }
  }
  found.in_none = std::move(free);
  return found;
}

std::vector<std::uint64_t> decode_column(VarintReader& reader, FieldType type, const ColumnImage& image,
                                         const std::vector<std::uint32_t>* plane, const Outside& outside) {
  return ColumnReader(reader, type, image, plane, outside).read();
}

std::vector<std::uint8_t> decode_point_bytes(VarintReader& reader, std::size_t points, std::size_t bytes,
                                             const Outside& outside) {
  const std::uint8_t form = reader.byte();
  if (form > 1) damaged("bytes of points of the unknown form " + std::to_string(form));
  std::vector<std::uint8_t> plain = zstd_frame(outside, reader.sized(), points * bytes);
  if (form == 1)
    for (std::size_t byte = 0; byte < bytes; ++byte)
      for (std::size_t i = byte * points + 1; i < (byte + 1) * points; ++i)
        plain[i] = static_cast<std::uint8_t>(plain[i] + plain[i - 1]);
  return plain;
}

}  // namespace lidarcodec
