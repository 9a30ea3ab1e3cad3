#include "session/planes.hpp"

#include <algorithm>
#include <bit>
#include <cmath>

#include "planes/intensity_coder.hpp"
#include "planes/neighbour.hpp"

namespace lidarcodec {
namespace {

constexpr std::uint8_t kModelled = 3, kForms = 6;  // forms 0 to 2 are in groups, 3 to 5 modelled
constexpr std::uint8_t kAllFired = 1, kFew = 2;    // of each three
constexpr std::size_t kGroupBytes = 9;             // first value u8, returns u32, size u32
constexpr std::size_t kPoseBytes = 96;
constexpr double kRounded = 0.1, kFarthest = 1e9;
constexpr std::uint16_t kTurn = 36'000;

[[noreturn]] void damaged(const std::string& what) { throw Error(ErrorCode::Section, what); }

// Intensities in groups by the one before; `count` of them.
std::vector<std::uint8_t> decode_grouped(Bytes data, std::size_t count, const Outside& outside) {
  const std::size_t groups = data.empty() ? 0 : data[0];
  const std::size_t at = 1 + groups * kGroupBytes;
  if (groups == 0 || data.size() < at)
    damaged(std::to_string(groups) + " groups of intensities in " + std::to_string(data.size()) + " bytes");
  NeighbourGroups group_of{};
  NeighbourCounts counts{};
  std::vector<std::size_t> sizes(groups);
  std::uint64_t returns = 0, bytes = 0;
  int before = -1;
  for (std::size_t g = 0; g < groups; ++g) {
    const std::size_t entry = 1 + g * kGroupBytes;
    if (data[entry] <= before || (g == 0 && data[entry] != 0))
      damaged("a group of intensities that begins at " + std::to_string(data[entry]));
    before = data[entry];
    std::fill(group_of.begin() + before, group_of.end(), static_cast<std::uint8_t>(g));
    counts[g] = static_cast<std::uint32_t>(little_endian(data, entry + 1, 4));
    sizes[g] = little_endian(data, entry + 5, 4);
    returns += counts[g];
    bytes += sizes[g];
  }
  if (returns != count || bytes != data.size() - at) damaged("groups of intensities that do not add up");
  std::vector<std::uint8_t> sorted;
  sorted.reserve(count);
  Bytes rest = data.subspan(at);
  for (std::size_t g = 0; g < groups; ++g) {
    const std::vector<std::uint8_t> part = zstd_frame(outside, rest.first(sizes[g]), counts[g]);
    sorted.insert(sorted.end(), part.begin(), part.end());
    rest = rest.subspan(sizes[g]);
  }
  return join_by_neighbour(sorted.data(), sorted.size(), group_of, counts);
}

template <class Number>
std::vector<Number> image(Bytes data, std::size_t rows, std::size_t width, const char* what) {
  if (data.size() != rows * width * sizeof(Number))
    damaged(std::string("a raw ") + what + " section of " + std::to_string(data.size()) + " bytes, not " +
            std::to_string(rows * width * sizeof(Number)));
  std::vector<Number> values(rows * width);
  const std::uint8_t* at = data.data();
  for (std::size_t i = 0; i < values.size(); ++i)
    if constexpr (sizeof(Number) == 1)
      values[i] = at[i];
    else
      values[i] = static_cast<Number>(at[2 * i] | at[2 * i + 1] << 8);
  return values;
}

}  // namespace

IntensitySection::IntensitySection(const Message& message) {
  const std::optional<Bytes> section = message.find(SectionType::Intensity);
  if (!section) return;
  if (section->empty() || section->front() >= kForms)
    damaged("an intensity section of " + std::to_string(section->size()) + " bytes, or of an unknown form");
  sent = true;
  modelled = section->front() >= kModelled;
  const std::uint8_t form = section->front() % kModelled;
  few = form == kFew;
  of_returns = section->subspan(1);
  if (form != kAllFired) return;
  if (of_returns.size() < 4) damaged("intensities that end within their size");
  const std::size_t size = std::min<std::size_t>(little_endian(of_returns, 0, 4), of_returns.size() - 4);
  of_others = of_returns.subspan(4 + size);
  of_returns = of_returns.subspan(4, size);
}

std::vector<std::uint8_t> decode_modelled(const IntensitySection& section, const Sensor& sensor, const Planes& planes,
                                          IntensityMemory& memory) {
  if (!section.modelled) return std::vector<std::uint8_t>(planes.returns.size());
  return decode_intensity(section.of_returns.data(), section.of_returns.size(), planes.returns.data(),
                          sensor.geometry(planes.width, planes.fired.data()), section.few ? nullptr : &memory,
                          planes.azimuth.data());
}

void decode_other_intensities(const IntensitySection& section, const Outside& outside, const Sensor& sensor,
                              Planes& planes) {
  const std::vector<std::uint8_t>& returns = planes.returns;
  if (section.sent && !section.modelled) {
    const auto count =
        static_cast<std::size_t>(std::count_if(returns.begin(), returns.end(), [](std::uint8_t r) { return r != 0; }));
    const std::vector<std::uint8_t> values = decode_grouped(section.of_returns, count, outside);
    for (std::size_t i = 0, from = 0; i < returns.size(); ++i)
      if (returns[i] != 0) planes.intensity[i] = values[from++];
  }
  if (!section.of_others) return;
  std::vector<std::size_t> cells;
  for (std::size_t row = 0; row < kRows; ++row) {
    const std::uint8_t* const fired = planes.fired.data() + sensor.beams.half[row] * planes.width;
    for (std::size_t c = 0; c < planes.width; ++c)
      if (fired[c] != 0 && returns[row * planes.width + c] == 0) cells.push_back(row * planes.width + c);
  }
  const std::vector<std::uint8_t> values = zstd_frame(outside, *section.of_others, cells.size());
  for (std::size_t i = 0; i < cells.size(); ++i) planes.intensity[cells[i]] = values[i];
}

std::optional<std::array<double, 12>> decode_pose(const Message& message) {
  const std::optional<Bytes> data = message.find(SectionType::Pose);
  if (!data) return std::nullopt;
  if (data->size() != kPoseBytes) damaged("a pose section of " + std::to_string(data->size()) + " bytes, not 96");
  std::array<double, 12> pose;
  for (std::size_t i = 0; i < pose.size(); ++i) {
    pose[i] = std::bit_cast<double>(little_endian(*data, 8 * i, 8));
    if (!(std::abs(pose[i]) < kFarthest)) damaged("a pose that is no rigid transform");
  }
  const auto r = [&](std::size_t row, std::size_t column) { return pose[4 * row + column]; };
  for (std::size_t i = 0; i < 3; ++i)
    for (std::size_t j = 0; j < 3; ++j) {
      const double dot = r(i, 0) * r(j, 0) + r(i, 1) * r(j, 1) + r(i, 2) * r(j, 2);
      if (!(std::abs(dot - (i == j ? 1.0 : 0.0)) < kRounded)) damaged("a pose that is no rigid transform");
    }
  const double determinant = r(0, 0) * (r(1, 1) * r(2, 2) - r(1, 2) * r(2, 1)) -
                             r(0, 1) * (r(1, 0) * r(2, 2) - r(1, 2) * r(2, 0)) +
                             r(0, 2) * (r(1, 0) * r(2, 1) - r(1, 1) * r(2, 0));
  if (!(determinant > 0)) damaged("a pose that is no rigid transform");
  return pose;
}

void check_side(const Message& message) {
  const bool has_positions = message.find(SectionType::Position).has_value();
  if (!message.find(SectionType::Side) && (message.packets > 0 || has_positions))
    damaged("a message of " + std::to_string(message.packets) + " packets without side information");
}

Planes decode_raw(const Message& message, const Sensor& sensor) {
  Planes planes;
  const std::size_t width = planes.width = message.width;
  planes.range = image<std::uint16_t>(message.section(SectionType::Range), kRows, width, "range");
  const Bytes angles = message.section(SectionType::Azimuth);
  const std::size_t split = std::min(4 * width, angles.size());
  planes.azimuth = image<std::uint16_t>(angles.first(split), 2, width, "azimuth");
  const std::vector<std::uint8_t> halves = image<std::uint8_t>(angles.subspan(split), 1, width, "azimuth");
  planes.fired.resize(2 * width);
  for (std::size_t c = 0; c < width; ++c) {
    if (planes.azimuth[c] >= kTurn || planes.azimuth[width + c] >= kTurn || halves[c] > 3)
      damaged("a raw azimuth section with an azimuth beyond 35999 or an unknown half");
    planes.fired[c] = halves[c] & 1;
    planes.fired[width + c] = halves[c] >> 1;
  }
  planes.intensity.assign(kRows * width, 0);
  if (const std::optional<Bytes> coded = message.find(SectionType::Intensity))
    planes.intensity = image<std::uint8_t>(*coded, kRows, width, "intensity");
  planes.returns.resize(kRows * width);
  for (std::size_t row = 0; row < kRows; ++row) {
    const std::uint8_t* const fired = planes.fired.data() + sensor.beams.half[row] * width;
    const std::uint16_t* const range = planes.range.data() + row * width;
    const std::uint8_t* const intensity = planes.intensity.data() + row * width;
    std::uint8_t* const returns = planes.returns.data() + row * width;
    unsigned unfired = 0;
    for (std::size_t c = 0; c < width; ++c) {
      returns[c] = range[c] != 0;
      unfired |= static_cast<unsigned>(fired[c] == 0) & static_cast<unsigned>((range[c] | intensity[c]) != 0);
    }
    if (unfired != 0) damaged("a raw message with returns in cells that were not fired");
  }
  return planes;
}

}  // namespace lidarcodec
