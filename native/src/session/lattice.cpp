#include "session/lattice.hpp"

#include <string>

namespace lidarcodec {
namespace {

constexpr std::size_t kHeadBytes = 11, kMostPackets = 2048, kTurn = 36'000;
constexpr std::uint8_t kRegular = 0, kListed = 1;

[[noreturn]] void damaged(const std::string& what) { throw Error(ErrorCode::Section, what); }

std::vector<std::size_t> columns_of(std::uint8_t kind, std::size_t width, Bytes data, const Outside& outside) {
  std::vector<std::size_t> columns;
  if (kind == kRegular && data.size() == 4) {
    const std::size_t step = little_endian(data, 0, 2), phase = little_endian(data, 2, 2);
    if (phase >= step)
      damaged("a lattice of every " + std::to_string(step) + ". column from " + std::to_string(phase) + " on");
    for (std::size_t at = 0; at < width; ++at)
      if (at == 0 || at == width - 1 || (at >= phase && (at - phase) % step == 0)) columns.push_back(at);
    return columns;
  }
  if (kind != kListed)
    damaged("a lattice section of kind " + std::to_string(kind) + " with " + std::to_string(data.size()) +
            " bytes of columns");
  const std::optional<std::vector<std::uint8_t>> gaps = outside.inflated(data, 2 * width);
  if (!gaps || gaps->size() % 2 != 0 || gaps->size() > 2 * width)
    damaged("a lattice section whose list of columns is damaged");
  std::size_t column = 0;
  for (std::size_t i = 0; i < gaps->size(); i += 2) {
    const std::size_t gap = little_endian(*gaps, i, 2);
    column += gap;
    if (column >= width || (i > 0 && gap == 0))
      damaged("a lattice section with columns beyond the " + std::to_string(width) + " of its frame, or twice");
    columns.push_back(column);
  }
  return columns;
}

// here + way / gap as an angle: the nearest, a half to the even one.
std::uint16_t turned(std::int64_t here, std::int64_t way, std::int64_t gap) {
  const std::int64_t twice = 2 * way + gap, unit = 2 * gap;
  std::int64_t value = here + (twice >= 0 ? twice / unit : -((unit - 1 - twice) / unit));
  if (twice % unit == 0 && value % 2 != 0) --value;
  return static_cast<std::uint16_t>((value + std::int64_t{kTurn}) % std::int64_t{kTurn});
}

// Straight between the columns that were sent, the short way round.
std::vector<std::uint16_t> widened_azimuth(const std::vector<std::uint16_t>& narrow, std::size_t width,
                                           const std::vector<std::size_t>& columns) {
  const std::size_t count = columns.size();
  std::vector<std::uint16_t> wide(2 * width);
  for (std::size_t half = 0; half < 2; ++half)
    for (std::size_t i = 0; i < count; ++i) {
      const bool more = i + 1 < count;
      const std::int64_t here = narrow[half * count + i];
      const std::size_t gap = (more ? columns[i + 1] : width) - columns[i];
      const std::int64_t way =
          more ? (narrow[half * count + i + 1] - here + std::int64_t{kTurn + kTurn / 2}) % std::int64_t{kTurn} -
                     std::int64_t{kTurn / 2}
               : 0;
      for (std::size_t place = 0; place < gap; ++place)
        wide[half * width + columns[i] + place] =
            turned(here, way * static_cast<std::int64_t>(place), static_cast<std::int64_t>(gap));
      for (std::size_t c = 0; i == 0 && c < columns[0]; ++c) wide[half * width + c] = static_cast<std::uint16_t>(here);
    }
  return wide;
}

}  // namespace

Lattice read_lattice(Bytes section, const Outside& outside) {
  if (section.size() < kHeadBytes)
    throw Error(ErrorCode::Truncated, "a lattice section of " + std::to_string(section.size()) + " bytes",
                section.size());
  Lattice lattice;
  const std::size_t width = lattice.width = little_endian(section, 1, 2), packets = little_endian(section, 3, 2);
  const std::size_t behind = kHeadBytes + little_endian(section, 5, 2), side = little_endian(section, 7, 4);
  if (width > kMostColumns || packets > kMostPackets)
    damaged("a lattice of " + std::to_string(width) + " columns and " + std::to_string(packets) + " packets");
  if (behind + side > section.size())
    throw Error(ErrorCode::Truncated, "a lattice section ends within what it announces", section.size());
  lattice.columns = columns_of(section[0], width, section.subspan(kHeadBytes, behind - kHeadBytes), outside);
  if (width > 0 && lattice.columns.empty())
    damaged("a lattice without columns for a frame of " + std::to_string(width));
  if (side == 0 && (packets > 0 || section.size() > behind)) damaged("a lattice of packets without side information");
  lattice.packets = side > 0;
  return lattice;
}

Planes in_own_columns(const Planes& narrow, Bytes section, const Outside& outside) {
  const Lattice lattice = read_lattice(section, outside);
  if (lattice.columns.size() != narrow.width)
    damaged("a lattice of " + std::to_string(lattice.columns.size()) + " columns for a frame of " +
            std::to_string(narrow.width));
  Planes whole;
  whole.width = lattice.width;
  whole.range = widened(narrow.range, kRows, lattice);
  whole.azimuth = widened_azimuth(narrow.azimuth, lattice.width, lattice.columns);
  whole.intensity = widened(narrow.intensity, kRows, lattice);
  whole.fired = widened(narrow.fired, 2, lattice);
  whole.returns = widened(narrow.returns, kRows, lattice);
  return whole;
}

}  // namespace lidarcodec
