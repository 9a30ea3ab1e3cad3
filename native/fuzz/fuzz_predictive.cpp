// Any bytes as ranges, and any ranges there and back. The input's first bytes say width, firings, sensor and step.
#include "../check/random_nets.hpp"
#include "parts/fuzz_ranges.hpp"
#include "predictive/kind.hpp"

using lidarcodec::kMaskRows;
using lidarcodec::MaskGeometry;
using lidarcodec::PredictiveCoder;

namespace {

// What a coder that has seen a frame before writes and reads, whatever the processors of both can do.
void check_two_frames(const Ranges& image, GivenFrame given, bool learned, std::uint32_t ways) {
  PredictiveCoder encoder(path_of(ways), nets_of(learned, ways / 64 % 16 == 0), ways % 2 == 0);
  PredictiveCoder decoder(path_of(ways >> 5), nets_of(learned, ways / 2048 % 16 == 0), ways % 32 == 0);
  for (std::uint32_t frame = 0; frame < 2; ++frame) {
    check_round_trip(image, given, ways / 16384 % 4 > frame, (ways >> 12 & 1u) == frame, encoder, decoder);
    given.cells.step = (5 * given.cells.step + 2) % 65536 | 1u;  // another odd one
    given.halves = given.halves != (ways % 5 == 0);
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
  for (std::size_t row = 0; row < kMaskRows; ++row) cells.level[row] = static_cast<std::int32_t>(turned * row % 1001);
  const Bytes returns = any.returns(holes);

  const Bytes rest = input.rest();
  const Ranges guesses = guesses_of(returns.size(), kind & 32u ? 0 : 7);
  const std::uint16_t* const expected = kind & 16u ? guesses.data() : nullptr;
  const lidarcodec::KnownColumns known = kind & 64u ? static_cast<lidarcodec::KnownColumns>(holes % (width + 1)) : -1;
  const bool learned = kind & 128u;
  // How it is coded, and whether there and back, mixed so that no setting goes with one way alone.
  const std::uint32_t ways = ((turn << 16 | std::uint32_t{holes} << 8 | kind) * 2654435761u) >> 16;
  const bool halves = known < 0 && ways % 3 == 0;
  const GivenFrame given{returns, geometry, cells, turn, expected, known, halves};
  try {
    Bytes coded = rest;
    if (kind & 1u) {  // a sound head
      const bool slab = known >= 0;
      const bool quick = !learned && (turn & 1024u), free = turn & 4096u;
      coded = {lidarcodec::RangeKind{expected != nullptr, slab, learned, quick, free, halves}.byte(),
               static_cast<std::uint8_t>(turn), static_cast<std::uint8_t>(turn >> 8),
               static_cast<std::uint8_t>(holes % 25u)};
      const std::size_t streams = slab ? 2 : halves ? 8 : 4, part = rest.size() * pattern / (256 * (streams - 1));
      for (std::size_t i = 0; i + 1 < streams; ++i)
        for (const std::size_t byte : {part & 255u, part >> 8, std::size_t{0}, std::size_t{0}})
          coded.push_back(static_cast<std::uint8_t>(byte));
      if (slab) coded.push_back(static_cast<std::uint8_t>(known));
      coded.insert(coded.end(), rest.begin(), rest.end());
    }
    PredictiveCoder coder(path_of(ways >> 3), nets_of(learned, ways / 512 % 16 == 0), ways % 64 == 0);
    Ranges seen(guesses.size());  // ranges of what is known, whatever was expected
    for (std::size_t i = 0; i < seen.size(); ++i) seen[i] = static_cast<std::uint16_t>((guesses[i] ^ turn) | 1u);
    const Ranges before = columns_of(seen, width, known);
    const Ranges came =
        coder.decode(coded.data(), coded.size(), returns.data(), cells, geometry, expected, known, before.data());
    if (ways / 4096 % 4 == 0) check_two_frames(came, given, learned, ways);
  } catch (const lidarcodec::Error&) {
  }
  if (kind & 2u && ways / 4096 % 4 == 1 && !returns.empty() && rest.size() > 1) {
    Ranges image(returns.size());
    for (std::size_t i = 0; i < image.size(); ++i) {
      const std::size_t at = i % (rest.size() - 1);
      image[i] = static_cast<std::uint16_t>(std::max(1, rest[at] << 8 | rest[at + 1]));
    }
    check_two_frames(image, given, learned, ways);
  }
  return 0;
}
