#include "session/frames/cloud_section.hpp"

#include <algorithm>
#include <array>
#include <bit>

#include "clouds/points.hpp"
#include "session/frames/cloud_columns.hpp"
#include "session/frames/cloud_positions.hpp"
#include "session/frames/plane_section.hpp"

namespace lidarcodec {
namespace {

constexpr std::uint8_t kPlain = 0, kZstd = 1, kColumns = 2, kNoImage = 0, kByColumn = 2;
constexpr std::size_t kMostBound = 100'000'000, kMostRows = 128, kMostCells = std::size_t{1} << 20;

[[noreturn]] void damaged(const std::string& what) { throw Error(ErrorCode::Section, what); }

std::vector<std::uint8_t> packed(VarintReader& reader, std::size_t most, const Outside& outside) {
  const std::size_t size = reader.number(most);
  return size == 0 ? std::vector<std::uint8_t>() : zstd_frame(outside, reader.sized(), size);
}

// The range image of points, without what its cells hold.
struct ImageHead {
  std::size_t rows = 0, columns = 0;
  bool by_column = false, full = false;
  std::vector<std::int64_t> firing;
};

ImageHead read_image_head(VarintReader& reader, std::uint8_t kind, std::size_t points) {
  if (kind > kByColumn) damaged("a range image of the unknown kind " + std::to_string(kind));
  ImageHead image;
  image.rows = std::size_t{reader.byte()} + 1;
  image.columns = reader.number(kMostColumns, 1);
  const std::uint8_t full = reader.byte();
  const std::size_t cells = image.rows * image.columns;
  if (image.rows > kMostRows || full > 1 || cells > kMostCells || cells < points)
    damaged("a range image of " + std::to_string(image.rows) + " x " + std::to_string(image.columns) + " for " +
            std::to_string(points) + " points");
  image.full = full == 1;
  image.by_column = kind == kByColumn;
  if (!image.by_column) return image;
  std::array<bool, kMostRows> seen{};
  for (const std::uint8_t row : reader.take(image.rows)) {
    if (row >= image.rows || seen[row]) damaged("the order of firing of a range image is damaged");
    seen[row] = true;
    image.firing.push_back(row);
  }
  return image;
}

// The message of a section of kind 2, written as it is read.
class CloudReader {
 public:
  CloudReader(VarintReader reader, const Outside& outside) : reader_(reader), outside_(outside) {}

  DecodedCloud read() {
    reader_.number(kMostBound);
    read_around();
    read_image();
    const CloudColumns columns = columns_of(head_, positioned_);
    for (std::size_t number = 0; number < columns.columns.size(); ++number) {
      const CloudColumn& column = columns.columns[number];
      put(column, decode_column(reader_, column.type, image_, plane("c" + std::to_string(number)), outside_));
    }
    read_gaps(columns.in_none);
    reader_.end();
    put_points();
    return std::move(cloud_);
  }

 private:
  std::size_t points() const { return static_cast<std::size_t>(head_.points()); }

  void read_around() {
    cloud_.payload = packed(reader_, kMostCloudBytes, outside_);
    head_ = read_cloud_head(cloud_.payload);
    if (head_.size != cloud_.payload.size() || !head_.regular() || head_.size + head_.data_bytes > kMostCloudBytes)
      damaged("the head of a cloud is not valid, or does not fit its points");
    if (points() == 0 || points() > kMostCloudPoints || head_.points() * head_.point_step > head_.data_bytes)
      damaged("a cloud of " + std::to_string(head_.points()) + " points in " + std::to_string(head_.data_bytes) +
              " bytes");
    const std::size_t between = head_.data_bytes - points() * head_.point_step;
    between_ = packed(reader_, between, outside_);
    tail_ = packed(reader_, kMostCloudBytes - head_.size - head_.data_bytes, outside_);
    if (between_.size() != between) damaged("rows of a cloud that are not as long as their step");
  }

  void read_image() {
    const std::uint8_t kind = reader_.byte();
    ImageHead head;
    if (kind != kNoImage) head = read_image_head(reader_, kind, points());
    const std::uint8_t positioned = reader_.byte();
    if (positioned > 1 || (positioned == 1 && kind == kNoImage))
      damaged("coordinates by a range image that is not there");
    positioned_ = positioned == 1;
    points_.resize(points() * head_.point_step);
    image_.n.assign(points(), 0);
    if (kind == kNoImage) return;
    read_planes(head);
    cells_ = {head.rows, head.columns, places_.row, places_.column};
    image_.cells = &cells_;
    if (positioned_) read_positions_by(*plane("range"));
    cloud_.image = CloudRows{head.rows, places_.row};
  }

  void read_planes(const ImageHead& head) {
    PlaneSection section = decode_plane_section(reader_.sized(), head.columns, outside_, nullptr);
    if (section.rows != head.rows)
      damaged("planes of " + std::to_string(section.rows) + " rows of a cloud of " + std::to_string(head.rows));
    PointOrder order{head.rows, head.columns, head.by_column, head.firing, {}};
    if (!head.full) order.ranges = section.planes[0].values;
    places_ = cells_of_points(order);
    if (places_.row.size() != points())
      damaged("a range image of " + std::to_string(places_.row.size()) + " points, not " + std::to_string(points()));
    for (NamedPlane& plane : section.planes) {
      plane.values = at_points(places_, head.columns, plane.values.data());
      planes_.push_back(std::move(plane));
    }
  }

  void read_positions_by(const std::vector<std::uint32_t>& ranges) {
    ReadPositions read = read_positions(reader_.sized(), cells_, ranges, outside_);
    image_.n = ranges;
    image_.k = std::move(read.found.k);
    geometry_ = std::move(read.geometry);
    image_.geometry = &geometry_;
    constexpr std::string_view kAxes = "xyz";
    for (std::size_t axis = 0; axis < kAxes.size(); ++axis) {
      const CloudField* const field = head_.named(kAxes.substr(axis, 1));
      if (field == nullptr || field->type != FieldType::Float32)
        damaged("coordinates in a cloud without a FLOAT32 " + std::string(kAxes.substr(axis, 1)));
      std::vector<std::uint64_t> values;
      for (const float value : read.found.xyz[axis]) values.push_back(std::bit_cast<std::uint32_t>(value));
      put({field->offset, field->type}, values);
    }
  }

  // Numbers of the points in a plane; nullptr if there is none of that name.
  const std::vector<std::uint32_t>* plane(const std::string& name) const {
    const auto found =
        std::find_if(planes_.begin(), planes_.end(), [&](const NamedPlane& one) { return one.name == name; });
    return found == planes_.end() ? nullptr : &found->values;
  }

  void put(const CloudColumn& column, const std::vector<std::uint64_t>& values) {
    const std::size_t width = bytes_of(column.type);
    std::uint8_t* to = points_.data() + column.at;
    for (const std::uint64_t value : values) {
      for (std::size_t byte = 0; byte < width; ++byte)
        to[head_.big_endian ? width - 1 - byte : byte] = static_cast<std::uint8_t>(value >> (8 * byte));
      to += head_.point_step;
    }
  }

  void read_gaps(const std::vector<bool>& in_none) {
    const auto count = static_cast<std::size_t>(std::count(in_none.begin(), in_none.end(), true));
    if (count == 0) return;
    const std::vector<std::uint8_t> bytes = decode_point_bytes(reader_, points(), count, outside_);
    auto next = bytes.begin();
    for (std::size_t at = 0; at < in_none.size(); ++at)
      for (std::size_t i = 0; in_none[at] && i < points(); ++i) points_[i * head_.point_step + at] = *next++;
  }

  // Points behind the head, row by row, and what is behind them.
  void put_points() {
    std::vector<std::uint8_t>& to = cloud_.payload;
    to.reserve(head_.size + head_.data_bytes + tail_.size());
    const std::size_t row = std::size_t{head_.width} * head_.point_step, gap = between_.size() / head_.height;
    for (std::size_t number = 0; number < head_.height; ++number) {
      const auto from = points_.begin() + static_cast<std::ptrdiff_t>(number * row);
      to.insert(to.end(), from, from + static_cast<std::ptrdiff_t>(row));
      const auto behind = between_.begin() + static_cast<std::ptrdiff_t>(number * gap);
      to.insert(to.end(), behind, behind + static_cast<std::ptrdiff_t>(gap));
    }
    to.insert(to.end(), tail_.begin(), tail_.end());
  }

  VarintReader reader_;
  const Outside& outside_;
  DecodedCloud cloud_;  // the payload is its head until all is read
  CloudHead head_;
  std::vector<std::uint8_t> between_, tail_, points_;
  bool positioned_ = false;
  PointCells places_;
  CloudCells cells_;
  CloudGeometry geometry_;
  ColumnImage image_;
  std::vector<NamedPlane> planes_;
};

}  // namespace

DecodedCloud decode_cloud(Bytes section, const Outside& outside) {
  VarintReader reader(section, "a cloud");
  const std::uint8_t kind = reader.byte();
  if (kind == kColumns) return CloudReader(reader, outside).read();
  if (kind == kZstd) {
    const std::size_t size = reader.number(kMostCloudBytes);
    return {zstd_frame(outside, reader.rest(), size), std::nullopt};
  }
  if (kind != kPlain) damaged("a cloud of the unknown kind " + std::to_string(kind));
  const Bytes payload = reader.rest();
  if (payload.size() > kMostCloudBytes) damaged("a cloud of " + std::to_string(payload.size()) + " bytes");
  return {{payload.begin(), payload.end()}, std::nullopt};
}

}  // namespace lidarcodec
