// Metadata of every firmware: in Python lidarcodec/sensors/models/ouster/metadata.py, which says what old files lack.
#include <algorithm>
#include <cmath>

#include "sensors/json.hpp"
#include "sensors/ouster.hpp"

namespace lidarcodec {
namespace {

using Kind = JsonValue::Kind;

constexpr double kMostLength = 10'000, kMostRotationError = 1e-3, kFirstBeamOrigin = 12.163;
constexpr std::array<double, 16> kFirstLidarToSensor = {-1, 0, 0, 0, 0, -1, 0, 0, 0, 0, 1, 36.18, 0, 0, 0, 1};
constexpr std::size_t kMostColumns = 64, kMostPacketBytes = 65'507;

[[noreturn]] void refuse(const std::string& why) { throw Error(ErrorCode::Section, "metadata of an Ouster: " + why); }

bool is_number(const JsonValue& value, double most) { return value.is_number() && std::abs(value.number) <= most; }
bool is_whole(const JsonValue& value, double least, double most) {
  return value.kind == Kind::Whole && value.number >= least && value.number <= most;
}
bool is_size(const JsonValue& value, std::size_t size) {
  return value.is_number() && value.number == static_cast<double>(size);
}

// A section: an object, or nothing.
const JsonValue* section(const JsonValue& tree, std::string_view name) {
  const JsonValue* const found = tree.find(name);
  if (found != nullptr && found->kind != Kind::Object) refuse(std::string(name) + " must be an object");
  return found;
}

// The value of a key in its section or at the top; nothing if it is in neither, or null.
const JsonValue* find(const JsonValue& tree, std::string_view part, std::string_view key) {
  const JsonValue* const in = section(tree, part);
  const JsonValue* found = in == nullptr ? nullptr : in->find(key);
  if (found == nullptr) found = tree.find(key);
  return found == nullptr || found->kind == Kind::Null ? nullptr : found;
}

const std::string* text(const JsonValue& tree, std::string_view part, std::string_view key) {
  const JsonValue* const found = find(tree, part, key);
  if (found != nullptr && found->kind != Kind::Text) refuse(std::string(key) + " must be a text");
  return found == nullptr ? nullptr : &found->text;
}

std::vector<double> beams(const JsonValue& tree, std::string_view key, double most) {
  const JsonValue* const found = find(tree, "beam_intrinsics", key);
  if (found == nullptr || found->kind != Kind::List) refuse("it lacks the list " + std::string(key));
  if (std::find(kOusterRows.begin(), kOusterRows.end(), found->list.size()) == kOusterRows.end())
    refuse(std::string(key) + " has " + std::to_string(found->list.size()) + " values");
  std::vector<double> angles;
  for (const JsonValue& value : found->list) {
    if (!is_number(value, most)) refuse(std::string(key) + " must hold angles");
    angles.push_back(value.number);
  }
  return angles;
}

std::size_t digits_at(const std::string& words, std::size_t at) {
  std::size_t end = at;
  while (end < words.size() && words[end] >= '0' && words[end] <= '9') ++end;
  return end - at;
}

// The number in digits; there are few of them.
std::size_t number_of(std::string_view digits) {
  std::size_t value = 0;
  for (const char digit : digits) value = 10 * value + static_cast<std::size_t>(digit - '0');
  return value;
}

// Columns of a turn: of `1024x10`.
std::size_t turn_columns(const JsonValue& tree, const JsonValue* data) {
  const std::string* const mode = text(tree, "config_params", "lidar_mode");
  if (mode == nullptr) refuse("it lacks lidar_mode");
  const std::size_t first = digits_at(*mode, 0), second = first < mode->size() ? digits_at(*mode, first + 1) : 0;
  const bool fits = first >= 3 && first <= 4 && first < mode->size() && (*mode)[first] == 'x' && second >= 1 &&
                    second <= 2 && first + 1 + second == mode->size();
  const std::size_t columns = fits ? number_of(std::string_view(*mode).substr(0, first)) : 0;
  if (!fits || number_of(std::string_view(*mode).substr(first + 1)) == 0 ||
      std::find(kOusterTurns.begin(), kOusterTurns.end(), columns) == kOusterTurns.end())
    refuse("its lidar_mode is not one of an Ouster");
  const JsonValue* const stated = data == nullptr ? nullptr : data->find("columns_per_frame");
  if (stated != nullptr && stated->kind != Kind::Null && !is_size(*stated, columns))
    refuse("columns_per_frame is not that of lidar_mode");
  return columns;
}

OusterPackets packets_of(const JsonValue& tree, const JsonValue* data, std::size_t rows) {
  const auto in_data = [&](std::string_view key) { return data == nullptr ? nullptr : data->find(key); };
  OusterPackets packets;
  packets.rows = rows;
  if (const JsonValue* const pixels = in_data("pixels_per_column"); pixels != nullptr && !is_size(*pixels, rows))
    refuse("pixels_per_column is not the number of its beams");
  if (const JsonValue* const each = in_data("columns_per_packet"); each != nullptr) {
    if (!is_whole(*each, 1, kMostColumns)) refuse("columns_per_packet must be 1 to 64");
    packets.columns = static_cast<std::size_t>(each->number);
  }
  const JsonValue* profile = in_data("udp_profile_lidar");
  if (profile == nullptr) profile = find(tree, "config_params", "udp_profile_lidar");
  if (profile != nullptr && profile->kind != Kind::Null) {
    const auto known = std::find_if(kOusterProfiles.begin(), kOusterProfiles.end(), [&](const OusterProfile& one) {
      return profile->kind == Kind::Text && one.name == profile->text;
    });
    if (known == kOusterProfiles.end()) refuse("its profile is unknown");
    packets.profile = static_cast<std::size_t>(known - kOusterProfiles.begin());
  }
  packets.fusa_head = packets.profile == kFusaProfile;
  if (const JsonValue* const head = in_data("header_type"); head != nullptr) {
    if (head->kind != Kind::Text || (head->text != "STANDARD" && head->text != "FUSA"))
      refuse("header_type must be STANDARD or FUSA");
    packets.fusa_head = packets.profile != kLegacyProfile && head->text == "FUSA";
  }
  if (packets.bytes() > kMostPacketBytes) refuse("its packets would be larger than those of any Ouster");
  return packets;
}

void check_window(const JsonValue* data, std::size_t columns) {
  const JsonValue* const window = data == nullptr ? nullptr : data->find("column_window");
  if (window == nullptr) return;
  const auto last = static_cast<double>(columns - 1);
  if (window->kind != Kind::List || window->list.size() != 2 || !is_whole(window->list[0], 0, last) ||
      !is_whole(window->list[1], 0, last))
    refuse("column_window must be two columns");
}

void check_shifts(const JsonValue* data, std::size_t rows, std::size_t columns) {
  const JsonValue* const shifts = data == nullptr ? nullptr : data->find("pixel_shift_by_row");
  if (shifts == nullptr || shifts->kind == Kind::Null) return;
  const auto most = static_cast<double>(columns);
  if (shifts->kind != Kind::List || shifts->list.size() != rows ||
      !std::all_of(shifts->list.begin(), shifts->list.end(),
                   [&](const JsonValue& shift) { return is_whole(shift, -most, most); }))
    refuse("pixel_shift_by_row must hold a number of columns for each beam");
}

// The family of `OS-1-128`: 0, 1, 2 or dome; "" if it is none.
std::string family_in(const std::string& product) {
  const auto lower = [](char one) { return one >= 'A' && one <= 'Z' ? static_cast<char>(one - 'A' + 'a') : one; };
  std::string words;
  for (const char one : product) words.push_back(lower(one));
  if (!words.starts_with("os")) return "";
  const std::size_t at = words.starts_with("os-") ? 3 : 2;
  for (const std::string family : {"0", "1", "2", "dome"}) {
    if (words.compare(at, family.size(), family) != 0) continue;
    const char after = at + family.size() < words.size() ? words[at + family.size()] : ' ';
    return (after >= '0' && after <= '9') || (after >= 'a' && after <= 'z') ? "" : family;
  }
  return "";
}

std::array<double, 16> transform(const JsonValue& tree, std::string_view part, std::string_view key,
                                 const std::array<double, 16>& usual) {
  const JsonValue* const found = find(tree, part, key);
  if (found == nullptr) return usual;
  std::vector<const JsonValue*> values;
  const auto is_list = [](const JsonValue& row) { return row.kind == Kind::List; };
  if (found->kind == Kind::List && found->list.size() == 4 &&
      std::all_of(found->list.begin(), found->list.end(), is_list)) {
    for (const JsonValue& row : found->list)
      for (const JsonValue& value : row.list) values.push_back(&value);
  } else if (found->kind == Kind::List) {
    for (const JsonValue& value : found->list) values.push_back(&value);
  }
  if (values.size() != 16) refuse(std::string(key) + " must hold 16 numbers");
  std::array<double, 16> matrix;
  for (std::size_t i = 0; i < 16; ++i) {
    if (!is_number(*values[i], kMostLength)) refuse(std::string(key) + " must hold 16 lengths");
    matrix[i] = values[i]->number;
  }
  const auto at = [&](std::size_t row, std::size_t column) { return matrix[4 * row + column]; };
  double off = 0;
  for (std::size_t i = 0; i < 3; ++i)
    for (std::size_t j = 0; j < 3; ++j) {
      const double dot = at(i, 0) * at(j, 0) + at(i, 1) * at(j, 1) + at(i, 2) * at(j, 2);
      off = std::max(off, std::abs(dot - (i == j ? 1.0 : 0.0)));
    }
  const double determinant = at(0, 0) * (at(1, 1) * at(2, 2) - at(1, 2) * at(2, 1)) -
                             at(0, 1) * (at(1, 0) * at(2, 2) - at(1, 2) * at(2, 0)) +
                             at(0, 2) * (at(1, 0) * at(2, 1) - at(1, 1) * at(2, 0));
  if (off > kMostRotationError || determinant < 0 || at(3, 0) != 0 || at(3, 1) != 0 || at(3, 2) != 0 || at(3, 3) != 1)
    refuse(std::string(key) + " must be a rotation and a shift");
  return matrix;
}

}  // namespace

OusterMetadata read_ouster_metadata(Bytes json) {
  const JsonValue tree = read_json_object(json);
  OusterMetadata metadata;
  metadata.altitude_deg = beams(tree, "beam_altitude_angles", 90);
  metadata.azimuth_deg = beams(tree, "beam_azimuth_angles", 360);
  const std::size_t rows = metadata.altitude_deg.size();
  const JsonValue* data = section(tree, "lidar_data_format");
  if (data == nullptr || data->names.empty()) data = section(tree, "data_format");
  metadata.turn_columns = turn_columns(tree, data);
  metadata.packets = packets_of(tree, data, rows);
  if (metadata.azimuth_deg.size() != rows) refuse("its beams have more angles of one kind than of the other");
  const std::string* const product = text(tree, "sensor_info", "prod_line");
  const bool named = product != nullptr && !product->empty();
  const std::string family = named ? family_in(*product) : "1";
  if (family.empty()) refuse("it does not describe an OS0, OS1, OS2 or OSDome");
  metadata.model = "os" + family + "-" + std::to_string(rows);
  double origin = !named          ? kFirstBeamOrigin
                  : family == "0" ? 27.67
                  : family == "1" ? 15.806
                  : family == "2" ? 13.762
                                  : 0.0;
  if (const JsonValue* const stated = find(tree, "beam_intrinsics", "lidar_origin_to_beam_origin_mm")) {
    if (!is_number(*stated, kMostLength)) refuse("lidar_origin_to_beam_origin_mm must be a length");
    origin = stated->number;
  }
  text(tree, "sensor_info", "prod_sn");
  check_window(data, metadata.turn_columns);
  check_shifts(data, rows, metadata.turn_columns);
  const std::array<double, 16> along_x = {1, 0, 0, origin, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1};
  metadata.beam_to_lidar = transform(tree, "beam_intrinsics", "beam_to_lidar_transform", along_x);
  metadata.lidar_to_sensor = transform(tree, "lidar_intrinsics", "lidar_to_sensor_transform", kFirstLidarToSensor);
  return metadata;
}

}  // namespace lidarcodec
