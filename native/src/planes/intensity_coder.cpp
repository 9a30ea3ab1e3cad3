#include "planes/intensity_coder.hpp"

#include <algorithm>
#include <utility>

#include "base/error.hpp"
#include "bits/rangecoder.hpp"
#include "mask/align.hpp"
#include "mask/rows.hpp"
#include "planes/intensity_rows.hpp"

namespace lidarcodec {

void forget_models(IntensityMemory& memory) {
  memory.cells.clear();
  memory.ended = {};
  memory.returns = 0;
}

namespace {

enum Kind : std::uint8_t { kConstant = 0, kCoded = 1, kGoesOn = 2, kFollowed = 3 };

constexpr std::size_t kConstantBytes = 2;  // kind, value
constexpr std::size_t kHeadBytes = 11;     // kind, turn u16, rate u16, bytes of the symbols u16 and first stream u32
constexpr std::size_t kOnBytes = 9;        // the same without symbols, of a section that goes on
constexpr std::uint32_t kMaxRate = 8191;

// The learning rate: higher where fewer returns were seen. Fitted to KITTI frames cut into pieces of each size, and for
// more returns to streams of two drives (0001 and 0013).
std::uint32_t rate_for(const IntensityMemory& memory) {
  constexpr std::array<std::uint32_t, 9> rates = {1700, 1450, 1220, 1020, 860, 600, 420, 300, 200};
  constexpr std::size_t in_a_frame = 5;
  std::size_t size = 0;
  for (std::size_t limit = 8192; size + 1 < (memory.follows ? rates.size() : in_a_frame) && memory.returns >= limit;
       limit *= 2)
    ++size;
  return rates[size];
}

struct Stream {
  std::uint32_t turn, rate;
};

// Codes all rows of an image, (64, W). Cells without a return are neither read nor written. memory: of the symbols;
// changed.
template <int Most, bool Follows, class Coder, class Image>
void code_rows(IntensityMemory& memory, const Stream& stream, const MaskLayout& layout, const MaskGeometry& geometry,
               const ClosedRows& returned, const std::uint16_t* azimuth,
               typename RowCoder<Most, Follows, Coder>::Halves& halves, Image* image) {
  const Symbols& symbols = memory.symbols;
  const std::size_t width = geometry.width;
  RowCoder<Most, Follows, Coder> coder(symbols, std::move(memory.cells), stream.rate, halves);
  memory.cells.clear();
  RowReturns returns(width);
  PaddedRow above(width);
  std::vector<std::uint8_t> here(width), before(width);  // symbols
  std::vector<std::uint16_t> directions(2 * width);
  if constexpr (Follows) std::transform(azimuth, azimuth + 2 * width, directions.begin(), IntensityTurn::direction);
  for (std::size_t row = 0; row < kMaskRows; ++row) {
    const std::size_t n = layout.cells(row);
    if (row == 0) {
      std::fill(above.cells() - PaddedRow::kMargin, above.cells() + n + PaddedRow::kMargin, std::uint8_t{1});
    } else {
      layout.align(before.data(), row - 1, row, layout.shift(row - 1, row, stream.turn), above);
    }
    const std::uint8_t* is_return = returned.cells.data() + row * width;
    returns.find(is_return, n);
    const std::vector<std::uint32_t>& columns = layout.columns(row);
    Image* const of_row = image + row * width;
    const auto for_each_return = [&](const auto& act) {
      for (std::size_t i = 0; i < returns.count; ++i) act(here[returns.cell[i]], of_row[columns[returns.cell[i]]]);
    };
    const std::uint16_t* const direction = directions.data() + geometry.half[row] * width;
    if constexpr (Follows)
      for (std::size_t i = 0; i < returns.count; ++i)
        returns.before[i] = memory.turn.before(row, direction[columns[returns.cell[i]]], symbols);
    if constexpr (!coder.kReads) for_each_return([&](auto& symbol, auto& value) { symbol = symbols.of_value[value]; });
    coder.code(row, returns, above.cells(), memory.ended[row] ? &memory.last[row] : nullptr, here.data());
    if constexpr (coder.kReads) for_each_return([&](auto& symbol, auto& value) { value = symbols.value[symbol]; });

    if constexpr (Follows)
      for (std::size_t k = 0; k < n; ++k)
        memory.turn.remember(row, direction[columns[k]],
                             is_return[k] != 0 ? symbols.value[here[k]] : IntensityTurn::kNothing);
    // For the row below, cells without a return take the symbol to their left, or the first one of the row.
    if (returns.count == 0) {
      std::copy_n(above.cells(), n, here.begin());
    } else {
      std::uint8_t symbol = here[returns.cell[0]];
      for (std::size_t k = 0; k < n; ++k) here[k] = symbol = is_return[k] ? here[k] : symbol;
      memory.last[row] = halves[returns.count > 1 ? 1 : 0].last;
      memory.ended[row] = true;
    }
    here.swap(before);
  }
  memory.cells = coder.give_cells();
}

template <bool Follows, class Coder, class... Given>
void code_rows_as(IntensityMemory& memory, Given&&... given) {
  switch (memory.symbols.depth) {
    case 8:
      return code_rows<8, Follows, Coder>(memory, given...);
    case 7:
      return code_rows<7, Follows, Coder>(memory, given...);
    case 6:
    case 5:
      return code_rows<6, Follows, Coder>(memory, given...);
    default:
      return code_rows<4, Follows, Coder>(memory, given...);
  }
}

template <class Coder, class... Given>
void code_rows_of(IntensityMemory& memory, Given&&... given) {
  if (memory.follows)
    code_rows_as<true, Coder>(memory, given...);
  else
    code_rows_as<false, Coder>(memory, given...);
}

void put(std::vector<std::uint8_t>& out, std::size_t value, int bytes) {
  for (int i = 0; i < bytes; ++i) out.push_back(static_cast<std::uint8_t>(value >> (8 * i)));
}

std::size_t take(const std::uint8_t* from, int bytes) {
  std::size_t value = 0;
  for (int i = bytes - 1; i >= 0; --i) value = value << 8 | from[i];
  return value;
}

void begin_models(IntensityMemory& memory, Symbols&& symbols) {
  memory.symbols = std::move(symbols);
  forget_models(memory);
}

// Whether all values of `few` are among those of `many`. Both rise.
bool has_all(const Symbols& many, const Symbols& few) {
  return std::includes(many.value.begin(), many.value.end(), few.value.begin(), few.value.end());
}

}  // namespace

std::vector<std::uint8_t> encode_intensity(const std::uint8_t* values, const std::uint8_t* returns,
                                           const MaskGeometry& geometry, std::uint32_t turn, IntensityMemory* memory,
                                           const std::uint16_t* azimuth) {
  if (turn > 65535) throw Error(ErrorCode::Section, "a turn of more than 65535 columns");
  const std::size_t width = geometry.width;
  const MaskLayout layout(geometry);
  const ClosedRows returned(returns, layout, width);
  IntensityMemory alone;
  IntensityMemory& taught = memory == nullptr ? alone : *memory;
  if (taught.follows && azimuth == nullptr) throw Error(ErrorCode::Section, "a stream of intensities needs azimuths");
  if (returned.returns == 0) return {};

  std::array<std::size_t, 256> counts{};
  for (std::size_t i = 0; i < kMaskRows * width; ++i) counts[values[i]] += returns[i] != 0;
  Symbols symbols = symbols_of(counts);
  if (symbols.count() == 1) return {kConstant, symbols.value[0]};
  std::vector<std::uint8_t> head;
  const bool goes_on = !taught.cells.empty() && has_all(taught.symbols, symbols);
  if (!goes_on) {
    begin_models(taught, memory == nullptr ? std::move(symbols) : symbols_of(counts, taught.seen));
    taught.symbols.place();
    BitWriter bits(head);
    code_symbols(bits, taught.symbols);
    bits.finish();
  }
  taught.returns += returned.returns;
  const Stream stream = {turn != 0 ? turn : find_turn(layout, returned.cells.data(), width), rate_for(taught)};
  std::array<Half<WideEncoder>, 2> halves;
  code_rows_of<WideEncoder>(taught, stream, layout, geometry, returned, azimuth, halves, values);
  for (const std::uint8_t value : taught.symbols.value) taught.seen[value] = true;
  const std::vector<std::uint8_t>& first = halves[0].coder.finish(halves[0].interval);
  const std::vector<std::uint8_t>& second = halves[1].coder.finish(halves[1].interval);

  std::vector<std::uint8_t> out;
  out.reserve(kHeadBytes + head.size() + first.size() + second.size());
  put(out, goes_on ? kGoesOn : taught.follows ? kFollowed : kCoded, 1);
  put(out, stream.turn, 2);
  put(out, stream.rate, 2);
  if (!goes_on) put(out, head.size(), 2);
  put(out, first.size(), 4);
  out.insert(out.end(), head.begin(), head.end());
  out.insert(out.end(), first.begin(), first.end());
  out.insert(out.end(), second.begin(), second.end());
  return out;
}

std::vector<std::uint8_t> decode_intensity(const std::uint8_t* data, std::size_t size, const std::uint8_t* returns,
                                           const MaskGeometry& geometry, IntensityMemory* memory,
                                           const std::uint16_t* azimuth) {
  const std::size_t width = geometry.width;
  const MaskLayout layout(geometry);
  const ClosedRows returned(returns, layout, width);
  std::vector<std::uint8_t> image(kMaskRows * width);
  if (returned.returns == 0) {
    if (size != 0) throw Error(ErrorCode::Section, "intensities where there are no returns");
    return image;
  }
  if (size < kConstantBytes) throw Error(ErrorCode::Truncated, "intensities end within their header", size);
  if (data[0] == kConstant) {
    if (size != kConstantBytes) throw Error(ErrorCode::Section, "bytes after the end of intensities", kConstantBytes);
    for (std::size_t i = 0; i < image.size(); ++i) image[i] = returns[i] != 0 ? data[1] : std::uint8_t{0};
    return image;
  }
  if (data[0] > kFollowed) throw Error(ErrorCode::Section, "intensities of an unknown kind");
  const bool goes_on = data[0] == kGoesOn, follows = data[0] == kFollowed;
  IntensityMemory alone;
  IntensityMemory& taught = memory == nullptr ? alone : *memory;
  if (goes_on && taught.cells.empty()) throw Error(ErrorCode::Section, "intensities that go on where nothing began");
  if ((goes_on ? taught.follows : follows) && (memory == nullptr || azimuth == nullptr))
    throw Error(ErrorCode::Section, "intensities of a stream, where none goes on");
  const std::size_t head_bytes = goes_on ? kOnBytes : kHeadBytes;
  if (size < head_bytes) throw Error(ErrorCode::Truncated, "intensities end within their header", size);
  const Stream stream = {static_cast<std::uint32_t>(take(data + 1, 2)), static_cast<std::uint32_t>(take(data + 3, 2))};
  if (stream.rate == 0 || stream.rate > kMaxRate)
    throw Error(ErrorCode::Section, "intensities that learn at a rate beyond the limits", 3);
  const std::size_t head = goes_on ? 0 : take(data + 5, 2), first = take(data + head_bytes - 4, 4);
  const std::size_t rest = size - head_bytes;
  if (head > rest || first > rest - head)
    throw Error(ErrorCode::Truncated, "intensities end before their streams do", size);

  if (!goes_on) {
    Symbols symbols;
    BitReader bits(data + kHeadBytes, head);
    code_symbols(bits, symbols);
    bits.finish();
    if (symbols.count() < 2) throw Error(ErrorCode::Section, "intensities of fewer than two values", kHeadBytes);
    begin_models(taught, std::move(symbols));
    taught.symbols.place();
    taught.follows = follows;
  }
  const std::uint8_t* streams = data + head_bytes + head;
  std::array<Half<WideDecoder>, 2> halves = {Half<WideDecoder>{WideDecoder(streams, first)},
                                             Half<WideDecoder>{WideDecoder(streams + first, rest - head - first)}};
  for (Half<WideDecoder>& half : halves) half.interval = half.coder.start();
  code_rows_of<WideDecoder>(taught, stream, layout, geometry, returned, azimuth, halves, image.data());
  for (const Half<WideDecoder>& half : halves) half.coder.finish(half.interval);
  return image;
}

}  // namespace lidarcodec
