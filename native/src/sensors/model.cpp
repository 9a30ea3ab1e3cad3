#include "sensors/model.hpp"

#include <algorithm>

#include "sensors/block_model.hpp"
#include "sensors/ouster.hpp"

namespace lidarcodec {
namespace {

constexpr std::uint32_t kCoarseStep = 80'000, kFineStep = 10'000;  // of an Ouster, 1e-7 m

const BlockModel* block_model(std::string_view name) {
  const std::span<const BlockModel> models = block_models();
  const auto found =
      std::find_if(models.begin(), models.end(), [&](const BlockModel& model) { return model.name == name; });
  return found == models.end() ? nullptr : &*found;
}

// Whether a name is that of an Ouster with metadata: "os1-128".
bool is_described(std::string_view name) {
  for (const std::string_view family : {"os0-", "os1-", "os2-", "osdome-"})
    for (const std::size_t rows : kOusterRows)
      if (name == std::string(family) + std::to_string(rows)) return true;
  return false;
}

// The packets of an Ouster without metadata: "ouster-128-legacy".
std::optional<OusterPackets> bare_packets(std::string_view name) {
  for (std::size_t profile = 0; profile < kOusterProfiles.size(); ++profile)
    for (const std::size_t rows : kOusterRows) {
      std::string made = "ouster-" + std::to_string(rows) + "-";
      for (const char one : kOusterProfiles[profile].name)
        made.push_back(one >= 'A' && one <= 'Z' ? static_cast<char>(one - 'A' + 'a') : one);
      if (made == name) return OusterPackets{profile, rows, 16, profile == kFusaProfile};
    }
  return std::nullopt;
}

}  // namespace

const std::vector<std::uint64_t>& series_named(const std::vector<Series>& series, std::string_view name) {
  const auto found = std::find_if(series.begin(), series.end(), [&](const Series& one) { return one.name == name; });
  if (found == series.end()) throw Error(ErrorCode::Section, "packets without the series " + std::string(name));
  return found->values;
}

bool is_known_model(std::string_view model) {
  return model == kAnyPackets || model == kPointCloud || block_model(model) != nullptr || is_described(model) ||
         bare_packets(model);
}

std::shared_ptr<const SensorFamily> family_of(std::string_view model, Bytes description, std::size_t rows,
                                              std::uint32_t range_step) {
  if (const BlockModel* const block = block_model(model)) return block_family(*block);
  if (const std::optional<OusterPackets> bare = bare_packets(model)) return ouster_family(*bare, std::nullopt);
  if (!is_described(model)) return nullptr;
  OusterMetadata metadata = read_ouster_metadata(description);
  const std::uint32_t step = kOusterProfiles[metadata.packets.profile].coarse ? kCoarseStep : kFineStep;
  if (metadata.model != model || metadata.packets.rows != rows || step != range_step)
    throw Error(ErrorCode::Section, "the description of a " + metadata.model + " does not fit a " + std::string(model));
  const OusterPackets packets = metadata.packets;
  return ouster_family(packets, std::move(metadata));
}

}  // namespace lidarcodec
