// Any bytes as JSON, as the metadata of an Ouster, and the frame geometry that follows from it.
#include <cmath>
#include <cstdlib>

#include "base/error.hpp"
#include "sensors/json.hpp"
#include "sensors/ouster.hpp"

namespace {

// Whether each member of an object has a value, and each number is one.
void check(const lidarcodec::JsonValue& value) {
  if (value.kind == lidarcodec::JsonValue::Kind::Object && value.names.size() != value.list.size()) std::abort();
  if (value.is_number() && !std::isfinite(value.number)) std::abort();
  for (const lidarcodec::JsonValue& inner : value.list) check(inner);
}

void check_family(const lidarcodec::OusterMetadata& metadata) {
  if (metadata.altitude_deg.size() != metadata.packets.rows || metadata.azimuth_deg.size() != metadata.packets.rows)
    std::abort();
  const auto family = lidarcodec::ouster_family(metadata.packets, metadata);
  if (family->rows() != metadata.packets.rows || metadata.packets.bytes() == 0) std::abort();
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const lidarcodec::Bytes bytes(data, size);
  try {
    check(lidarcodec::read_json_object(bytes));
  } catch (const lidarcodec::Error&) {
  }
  try {
    check_family(lidarcodec::read_ouster_metadata(bytes));
  } catch (const lidarcodec::Error&) {
  }
  return 0;
}
