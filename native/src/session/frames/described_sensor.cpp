#include "session/frames/described_sensor.hpp"

#include <numeric>

#include "base/utf8.hpp"
#include "session/frames/names.hpp"

namespace lidarcodec {
namespace {

constexpr std::uint8_t kForm = 3;
constexpr std::size_t kHeadBytes = 12, kMostRows = 128, kMostDescription = std::size_t{1} << 20,
                      kMostBytes = kMostDescription + (std::size_t{1} << 14), kShownModel = 40;

// Of a sensor whose model and rows are known.
std::shared_ptr<const SensorFamily> described_family(const DescribedSensor& sensor) {
  try {
    return family_of(sensor.model, sensor.description, sensor.rows(), sensor.range_step);
  } catch (const Error& error) {
    throw Error(error.code(), std::string("a sensor whose description cannot be used: ") + error.what());
  }
}

std::shared_ptr<const DescribedSensor> read_described(Bytes data, const Outside& outside) {
  const std::size_t at = 1 + kHashBytes;
  const std::uint64_t size = data.size() < at + 4 ? 0 : little_endian(data, at, 4);
  if (size < kHeadBytes || size > kMostBytes)
    throw Error(ErrorCode::Section, "a calibration section of " + std::to_string(data.size()) +
                                        " bytes that announces " + std::to_string(size));
  const std::vector<std::uint8_t> plain = zstd_frame(outside, data.subspan(at + 4), size);
  ByteReader reader(plain, "a calibration");
  auto sensor = std::make_shared<DescribedSensor>();
  sensor->convention = static_cast<std::uint8_t>(reader.number(1));
  sensor->range_step = static_cast<std::uint32_t>(reader.number(4));
  const std::size_t name_bytes = reader.number(1), model_bytes = reader.number(1), rows = reader.number(1),
                    description_bytes = reader.number(4);
  if (sensor->convention > 1 || sensor->range_step == 0 || rows < 1 || rows > kMostRows)
    throw Error(ErrorCode::Section, "calibration of unknown convention " + std::to_string(sensor->convention) +
                                        ", range step " + std::to_string(sensor->range_step) + " or " +
                                        std::to_string(rows) + " rows");
  const std::size_t cells = kCalibrationRows * rows;
  if (reader.left() != std::uint64_t{name_bytes} + model_bytes + description_bytes + 4 * cells)
    throw Error(ErrorCode::Section, "a calibration of " + std::to_string(size) + " bytes whose parts do not add up");
  const Bytes name = reader.take(name_bytes), model = reader.take(model_bytes),
              description = reader.take(description_bytes);
  if (!is_utf8(name)) throw Error(ErrorCode::Section, "a sensor name that is not UTF-8");
  sensor->name.assign(name.begin(), name.end());
  sensor->model.assign(model.begin(), model.end());
  sensor->description.assign(description.begin(), description.end());
  const bool plain_model = is_plain_name(model, "-");
  if (!is_known_model(sensor->model) && !(plain_model && outside.takes_model(sensor->model)))
    throw Error(ErrorCode::Section, (plain_model ? "a sensor of model '" + sensor->model.substr(0, kShownModel) + "'"
                                                 : std::string("a sensor of a model")) +
                                        ", which this build does not know: update it");

  const Bytes table = Bytes(plain).subspan(reader.at());
  sensor->table.lasers = rows;
  for (std::size_t i = 0; i < cells; ++i)
    sensor->table.values.push_back(static_cast<std::int32_t>(little_endian(table, 4 * i, 4)));
  sensor->laser.resize(rows);
  std::iota(sensor->laser.begin(), sensor->laser.end(), std::uint8_t{0});
  std::stable_sort(sensor->laser.begin(), sensor->laser.end(), [&](std::uint8_t a, std::uint8_t b) {
    return sensor->table.at(kElevationRow, a) > sensor->table.at(kElevationRow, b);
  });
  sensor->family = described_family(*sensor);

  std::vector<std::uint8_t> hashed(name.begin(), name.end());
  hashed.push_back(0);
  hashed.insert(hashed.end(), table.begin(), table.end());
  hashed.push_back(0);
  hashed.insert(hashed.end(), model.begin(), model.end());
  hashed.push_back(0);
  hashed.insert(hashed.end(), description.begin(), description.end());
  sensor->hash = hex(Bytes(sha256(hashed)).first(kHashBytes));
  return sensor;
}

}  // namespace

std::shared_ptr<const DescribedSensor> DescribedSensorBook::of(const Message& message, const Outside& outside) {
  return known_.of(
      message, [](std::uint8_t form) { return form == kForm; },
      [&](Bytes data) { return read_described(data, outside); });
}

}  // namespace lidarcodec
