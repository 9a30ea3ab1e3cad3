// Columns of a CLOUD section (docs/wire-format-clouds.md, "Columns"): fields of all points of a cloud;
// lidarcodec/planes/clouds/columns.py writes them.
#pragma once
#include "base/varint.hpp"
#include "clouds/columns.hpp"
#include "clouds/message.hpp"
#include "session/outside.hpp"

namespace lidarcodec {

// A value of a field in a point: its first byte there, and its type.
struct CloudColumn {
  std::size_t at = 0;
  FieldType type = FieldType::Float32;
};

// The columns of points, in their order; in_none: of each byte of a point, whether it is in none of them.
struct CloudColumns {
  std::vector<CloudColumn> columns;
  std::vector<bool> in_none;
};
// without_xyz: fields x, y and z of one value are no columns. The head is a regular one.
CloudColumns columns_of(const CloudHead& head, bool without_xyz);

// What columns refer to. cells: nullptr without a range image; geometry: nullptr if coordinates are not coded by it.
struct ColumnImage {
  const CloudCells* cells = nullptr;
  const CloudGeometry* geometry = nullptr;
  std::vector<std::uint32_t> n;  // of each point, 0 without coordinates by the image
  std::vector<std::int32_t> k;
};

// Bits of the values of a column, one for each point. plane: numbers of its plane, if it has one. Raises Section or
// Truncated.
std::vector<std::uint64_t> decode_column(VarintReader& reader, FieldType type, const ColumnImage& image,
                                         const std::vector<std::uint32_t>* plane, const Outside& outside);

// Bytes of points as of way 0: the first ones of all, then the second ones, ... Raises Section or Truncated.
std::vector<std::uint8_t> decode_point_bytes(VarintReader& reader, std::size_t points, std::size_t bytes,
                                             const Outside& outside);

}  // namespace lidarcodec
