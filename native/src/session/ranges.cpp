#include "session/ranges.hpp"

#include <algorithm>
#include <string>

#include "mask/coder.hpp"
#include "pco/groups.hpp"

namespace lidarcodec {
namespace {

constexpr std::uint32_t kMostStep = 20'001, kMostRange = 65'535;

// Differences of consecutive indices, folded: all low bytes, then all high.
std::vector<std::uint16_t> summed(const std::vector<std::uint8_t>& bytes) {
  const std::size_t count = bytes.size() / 2;
  std::vector<std::uint16_t> indices(count);
  std::uint32_t index = 0;
  for (std::size_t i = 0; i < count; ++i) {
    const std::uint32_t folded = bytes[i] | std::uint32_t{bytes[count + i]} << 8;
    index += (folded >> 1) ^ (0u - (folded & 1u));
    indices[i] = static_cast<std::uint16_t>(index);
  }
  return indices;
}

// Indices of the returns in row order.
std::vector<std::uint16_t> indices_of(const Message& message, Bytes coded, const Outside& outside,
                                      const std::vector<std::uint8_t>& returns, std::size_t count) {
  if (message.codec == Codec::Zstd) return summed(zstd_frame(outside, coded, 2 * count));
  if (count == 0) {
    if (!coded.empty())
      throw Error(ErrorCode::Section, std::to_string(coded.size()) + " bytes of ranges for no return");
    return {};
  }
  if (message.codec == Codec::Pcodec) return decode_pco_groups(coded.data(), coded.size(), count);
  const std::vector<std::uint16_t> samples = samples_of(outside, {message.codec, coded, kMaskRows, message.width});
  std::vector<std::uint16_t> indices;
  indices.reserve(count);
  for (std::size_t i = 0; i < returns.size(); ++i)
    if (returns[i] != 0) indices.push_back(samples[i]);
  return indices;
}

}  // namespace

std::pair<std::uint32_t, Bytes> split_step(Bytes section) {
  if (section.size() < 2)
    throw Error(ErrorCode::Section, "a range section of " + std::to_string(section.size()) + " bytes has no step");
  const auto step = static_cast<std::uint32_t>(little_endian(section, 0, 2));
  if (step > kMostStep || step % 2 == 0)
    throw Error(ErrorCode::Section,
                "range step " + std::to_string(step) + " is not an odd number from 1 to " + std::to_string(kMostStep));
  return {step, section.subspan(2)};
}

std::uint16_t range_of_index(std::uint32_t index, std::uint32_t step) {
  if (step == 1) {
    if (index == 0) throw Error(ErrorCode::Section, "a return of range 0");
    return static_cast<std::uint16_t>(index);
  }
  if (const std::uint32_t top = (kMostRange + step / 2) / step; index > top)
    throw Error(ErrorCode::Section, "range index " + std::to_string(index) + " beyond " + std::to_string(top) +
                                        ", the last of step " + std::to_string(step));
  return static_cast<std::uint16_t>(index == 0 ? (step / 2 + 1) / 2 : std::min(index * step, kMostRange));
}

std::vector<std::uint16_t> decode_quantised(const Message& message, const Outside& outside,
                                            const std::vector<std::uint8_t>& returns) {
  const auto [step, coded] = split_step(message.section(SectionType::Range));
  const auto count =
      static_cast<std::size_t>(std::count_if(returns.begin(), returns.end(), [](std::uint8_t r) { return r != 0; }));
  const std::vector<std::uint16_t> indices = indices_of(message, coded, outside, returns, count);
  std::vector<std::uint16_t> ranges(returns.size());
  for (std::size_t i = 0, from = 0; i < returns.size(); ++i)
    if (returns[i] != 0) ranges[i] = range_of_index(indices[from++], step);
  return ranges;
}

}  // namespace lidarcodec
