// Any bytes as ranges, and any ranges there and back. The input's first bytes say width, firings, sensor and step.
#include <cstdlib>
#include <vector>

#include "error.hpp"
#include "fuzz_geometry.hpp"
#include "fuzz_input.hpp"
#include "predictive_coder.hpp"
#include "../check/random_nets.hpp"

using lidarcodec::kMaskRows;
using lidarcodec::MaskGeometry;
using lidarcodec::PredictiveCoder;

namespace {

using Bytes = std::vector<std::uint8_t>;
using Ranges = std::vector<std::uint16_t>;

// The first columns of an image, which both ends of a slab know; none of a whole frame.
Ranges columns_of(const Ranges& image, std::size_t width, lidarcodec::KnownColumns known) {
  Ranges before;
  for (std::size_t row = 0; row < kMaskRows && known > 0; ++row)
    before.insert(before.end(), image.begin() + static_cast<std::ptrdiff_t>(row * width),
                  image.begin() + static_cast<std::ptrdiff_t>(row * width) + known);
  return before;
}

// One of the ways to code that this processor has, by any number. The plain one is for few: it takes ten times as long under
// the sanitizers, and no input decides its course.
lidarcodec::Path path_of(std::uint32_t number) {
  const std::vector<lidarcodec::Path> paths = lidarcodec::paths_here();
  return paths.size() == 1 || number % 16 == 0 ? paths.front() : paths[1 + number / 16 % (paths.size() - 1)];
}

// What a coder that has seen a frame before writes and reads, whatever the processors of both can do.
void check_round_trip(const Ranges& image, const Bytes& returns, lidarcodec::RangeCells cells,
                      const MaskGeometry& geometry, std::uint32_t turn, const std::uint16_t* expected,
                      lidarcodec::KnownColumns known, bool learned, std::uint32_t ways) {
  const Ranges before = columns_of(image, geometry.width, known);
  PredictiveCoder encoder(path_of(ways), nets_of(learned, ways / 64 % 16 == 0));
  PredictiveCoder decoder(path_of(ways >> 5), nets_of(learned, ways / 2048 % 16 == 0));
  for (int frame = 0; frame < 2; ++frame) {
    const bool quick = ways / 16384 % 4 > static_cast<std::uint32_t>(frame);
    const bool free = (ways >> 12 & 1u) == static_cast<std::uint32_t>(frame);
    Ranges sent(image.size());
    const Bytes data = encoder.encode(image.data(), returns.data(), cells, geometry, turn, turn >> 9, expected, known, nullptr, quick, free ? sent.data() : nullptr);
    const Ranges came =
        decoder.decode(data.data(), data.size(), returns.data(), cells, geometry, expected, known, before.data());
    for (std::size_t i = 0; i < image.size(); ++i) {
      const int apart = returns[i] != 0 ? std::abs(int{came[i]} - int{image[i]}) : came[i];
      const bool is_known = static_cast<lidarcodec::KnownColumns>(i % geometry.width) < known;
      if (is_known ? came[i] != image[i]
                   : apart > static_cast<int>(cells.step / 2) || (returns[i] != 0 && came[i] == 0))
        std::abort();
      if (free && cells.step > 1 && !is_known && came[i] != sent[i]) std::abort();
    }
    cells.step = (5 * cells.step + 2) % 65536 | 1u;  // another odd one
  }
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  FuzzInput input(data, size);
  const std::size_t width = input.below(20);  // wider ones take longer and show nothing else
  const std::uint8_t pattern = input.byte(), holes = input.byte(), turned = input.byte(), kind = input.byte();
  const std::uint32_t turn = input.below(65536);  // 0: found from the returns
  lidarcodec::RangeCells cells;
  cells.step = kind & 8u ? 2 * input.below(32768) + 1 : 1 + 2 * (input.byte() % 32u);

  const FuzzGeometry any(width, pattern, turned, (kind & 4u) != 0);
  const MaskGeometry& geometry = any.image;
  for (std::size_t row = 0; row < kMaskRows; ++row)
    cells.level[row] = static_cast<std::int32_t>(turned * row % 1001);
  const Bytes returns = any.returns(holes);

  const Bytes rest = input.rest();
  Ranges guesses(returns.size());
  for (std::size_t i = 0; i < guesses.size(); ++i)
    guesses[i] = static_cast<std::uint16_t>(i * 40503u >> (kind & 32u ? 0 : 7)) * (i % 5 != 0);
  const std::uint16_t* const expected = kind & 16u ? guesses.data() : nullptr;
  const lidarcodec::KnownColumns known = kind & 64u ? static_cast<lidarcodec::KnownColumns>(holes % (width + 1)) : -1;
  const bool learned = kind & 128u;
  // How it is coded, and whether there and back, mixed so that no setting goes with one way alone.
  const std::uint32_t ways = ((turn << 16 | std::uint32_t{holes} << 8 | kind) * 2654435761u) >> 16;
  try {
    Bytes coded = rest;
    if (kind & 1u) {  // a sound head
      const bool slab = known >= 0;
      const bool counted = turn & 512u, quick = counted && !learned && (turn & 1024u), by_leaf = counted && !quick && (turn & 2048u);
      const bool free = (quick || by_leaf) && (turn & 4096u);
      coded = {static_cast<std::uint8_t>((expected == nullptr ? 1 : 2) + (slab ? 2 : 8) + (learned ? 16 : 0) + (counted ? 32 : 0) + (free ? 4 : 0) + (quick ? 128 : by_leaf ? 192 : 0)),
               static_cast<std::uint8_t>(turn), static_cast<std::uint8_t>(turn >> 8)};
      if (counted) coded.push_back(holes % 25u);
      const std::size_t streams = slab ? 2 : 4, part = rest.size() * pattern / (256 * (streams - 1));
      for (std::size_t i = 0; i + 1 < streams; ++i)
        for (const std::size_t byte : {part & 255u, part >> 8, std::size_t{0}, std::size_t{0}}) coded.push_back(static_cast<std::uint8_t>(byte));
      if (slab) coded.push_back(static_cast<std::uint8_t>(known));
      coded.insert(coded.end(), rest.begin(), rest.end());
    }
    PredictiveCoder coder(path_of(ways >> 3), nets_of(learned, ways / 512 % 16 == 0));
    Ranges seen(guesses.size());  // ranges of what is known, whatever was expected
    for (std::size_t i = 0; i < seen.size(); ++i) seen[i] = static_cast<std::uint16_t>((guesses[i] ^ turn) | 1u);
    const Ranges before = columns_of(seen, width, known);
    const Ranges came = coder.decode(coded.data(), coded.size(), returns.data(), cells, geometry, expected, known, before.data());
    if (ways / 4096 % 4 == 0) check_round_trip(came, returns, cells, geometry, turn, expected, known, learned, ways);
  } catch (const lidarcodec::Error&) {
  }
  if (kind & 2u && ways / 4096 % 4 == 1 && !returns.empty() && rest.size() > 1) {
    Ranges image(returns.size());
    for (std::size_t i = 0; i < image.size(); ++i) {
      const std::size_t at = i % (rest.size() - 1);
      image[i] = static_cast<std::uint16_t>(std::max(1, rest[at] << 8 | rest[at + 1]));
    }
    check_round_trip(image, returns, cells, geometry, turn, expected, known, learned, ways);
  }
  return 0;
}
