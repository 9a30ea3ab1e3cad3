// Free ranges alone, in small frames: any bytes behind a sound head of each of their kinds or instead of one, and any
// ranges there and back over two or three frames, free and rounded ones, of one step and of others. fuzz_predictive has
// all kinds of ranges and whole sections.
#include <array>
#include <memory>

#include "../check/random_nets.hpp"
#include "parts/fuzz_ranges.hpp"
#include "predictive/kind.hpp"

using lidarcodec::kMaskRows;
using lidarcodec::PredictiveCoder;

namespace {

// A coder that has learned nothing. Tables take longer to make than small frames to code, so coders are kept.
PredictiveCoder& fresh(bool writes, std::uint32_t way, bool learned) {
  const std::vector<lidarcodec::Path> paths = lidarcodec::paths_here();
  const bool plain = paths.size() == 1 || way % 64 == 9;  // ten times as long under the sanitizers
  const lidarcodec::Path path = plain ? paths.front() : paths[1 + way / 64 % (paths.size() - 1)];
  static std::array<std::unique_ptr<PredictiveCoder>, 16> kept;
  std::unique_ptr<PredictiveCoder>& coder = kept[(static_cast<std::size_t>(path) * 2 + learned) * 2 + writes];
  if (coder == nullptr) coder = std::make_unique<PredictiveCoder>(path, nets_of(learned, false));
  if (learned) coder->change(nets_of(true, way / 128 % 32 == 9));
  coder->reset();
  return *coder;
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  FuzzInput input(data, size);
  const std::size_t width =
      1 + input.byte() % 6u;  // small frames, so that there are many: all rows have returns in few
  const std::uint8_t pattern = input.byte(), rows = input.byte(), holes = input.byte(), turned = input.byte();
  const std::uint8_t kind = input.byte(), how = input.byte(), split = input.byte();
  const std::uint32_t turn = input.below(65536);
  lidarcodec::RangeCells cells;
  cells.step = 3 + 2 * (kind & 8u ? input.below(32767) : input.byte() % 32u);
  for (std::size_t row = 0; row < kMaskRows; ++row) cells.level[row] = static_cast<std::int32_t>(turned * row % 1001);

  const FuzzGeometry any(width, pattern, turned, (kind & 4u) != 0);
  Bytes returns = any.returns(holes);
  for (std::size_t i = 0; i < returns.size(); ++i) returns[i] &= (rows == 0 ? 1 : rows) >> (i / width % 8) & 1;
  const Ranges guesses = guesses_of(returns.size(), kind & 32u ? 0 : 7);
  const bool slab = (kind & 64u) != 0, quick = (kind & 128u) != 0, learned = !quick && (how & 1u) != 0;
  GivenFrame given{returns,
                   any.image,
                   cells,
                   turn,
                   kind & 16u ? guesses.data() : nullptr,
                   slab ? static_cast<lidarcodec::KnownColumns>(how / 4 % (width + 1)) : lidarcodec::kWholeFrame,
                   !slab && how / 4 % 2 != 0};
  const Bytes rest = input.rest();
  const std::uint32_t ways = ((turn << 16 | std::uint32_t{holes} << 8 | how) * 2654435761u) >> 16;

  if ((kind & 1u) != 0 || (how & 2u) != 0) {
    const std::size_t streams = slab ? 2 : given.halves ? 8 : 4, part = rest.size() * split / (256 * (streams - 1));
    Bytes coded = {lidarcodec::RangeKind{given.expected != nullptr, slab, learned, quick, true, given.halves}.byte(),
                   static_cast<std::uint8_t>(turn), static_cast<std::uint8_t>(turn >> 8),
                   static_cast<std::uint8_t>(split % 25)};
    for (std::size_t i = 0; i + 1 < streams; ++i)
      for (const std::size_t byte : {part & 255u, part >> 8, std::size_t{0}, std::size_t{0}})
        coded.push_back(static_cast<std::uint8_t>(byte));
    if (slab) coded.push_back(static_cast<std::uint8_t>(given.known));
    coded.insert(coded.end(), rest.begin(), rest.end());
    if (how & 2u) coded = rest;  // with a head of its own
    Ranges seen(guesses.size());
    for (std::size_t i = 0; i < seen.size(); ++i) seen[i] = static_cast<std::uint16_t>((guesses[i] ^ turn) | 1u);
    const Ranges before = columns_of(seen, width, given.known);
    try {
      fresh(false, ways, learned)
          .decode(coded.data(), coded.size(), returns.data(), cells, given.geometry, given.expected, given.known,
                  before.data());
    } catch (const lidarcodec::Error&) {
    }
    return 0;
  }
  if (rest.size() < 2) return 0;
  Ranges image(returns.size());
  for (std::size_t i = 0; i < image.size(); ++i) {
    const std::size_t at = i % (rest.size() - 1);
    const int sent = kind & 2u ? 3000 + rest[at] / 4 : rest[at] << 8 | rest[at + 1];  // a surface, or anything
    image[i] = static_cast<std::uint16_t>(sent > 0 ? sent : 1);
  }
  PredictiveCoder& encoder = fresh(true, ways, learned);
  PredictiveCoder& decoder = fresh(false, ways >> 5, learned);
  for (int frame = 0; frame < (split & 32u ? 3 : 2); ++frame) {
    const bool free = frame == 0 || (split >> frame & 1u) != 0;
    check_round_trip(image, given, quick != (frame == 1 && (split & 8u)), free, encoder, decoder);
    if (split & 16u) given.cells.step = (5 * given.cells.step + 2) % 65536 | 1u;  // another odd one
  }
  return 0;
}
