#include "planes/intensity_coder.hpp"

#include "base/error.hpp"
#include "bits/rangecoder.hpp"
#include "mask/align.hpp"
#include "mask/rows.hpp"
#include "planes/intensity_rows.hpp"

namespace lidarcodec {
namespace {

enum Kind : std::uint8_t { kConstant = 0, kCoded = 1 };

constexpr std::size_t kConstantBytes = 2;  // kind, value
constexpr std::size_t kHeadBytes = 11;     // kind, turn u16, rate u16, bytes of the symbols u16 and first stream u32
constexpr std::uint32_t kMaxRate = 8191;

// The learning rate: higher for frames with fewer returns. Fitted to KITTI frames cut into pieces of each size.
std::uint32_t rate_for(std::size_t returns) {
  constexpr std::array<std::uint32_t, 5> rates = {1700, 1450, 1220, 1020, 860};
  std::size_t size = 0;
  for (std::size_t limit = 8192; size + 1 < rates.size() && returns >= limit; limit *= 2) ++size;
  return rates[size];
}

struct Stream {
  std::uint32_t turn, rate;
};

// Codes all rows of an image, (64, W). Cells without a return are neither read nor written.
template <int Depth, class Coder, class Image>
void code_rows(const Symbols& symbols, const Stream& stream, const MaskLayout& layout, const ClosedRows& returned,
               std::size_t width, typename RowCoder<Depth, Coder>::Halves& halves, Image* image) {
  RowCoder<Depth, Coder> coder(symbols, stream.rate, halves);
  RowReturns returns(width);
  PaddedRow above(width);
  std::vector<std::uint8_t> here(width), before(width);  // symbols
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
    if constexpr (!coder.kReads) for_each_return([&](auto& symbol, auto& value) { symbol = symbols.of_value[value]; });
    coder.code(returns, above.cells(), here.data());
    if constexpr (coder.kReads) for_each_return([&](auto& symbol, auto& value) { value = symbols.value[symbol]; });

    // For the row below, cells without a return take the symbol to their left, or the first one of the row.
    if (returns.count == 0) {
      std::copy_n(above.cells(), n, here.begin());
    } else {
      std::uint8_t symbol = here[returns.cell[0]];
      for (std::size_t k = 0; k < n; ++k) here[k] = symbol = is_return[k] ? here[k] : symbol;
    }
    here.swap(before);
  }
}

template <class Coder, class... Given>
void code_rows_of(const Symbols& symbols, Given&&... given) {
  switch (symbols.depth) {
    case 1:
      return code_rows<1, Coder>(symbols, given...);
    case 2:
      return code_rows<2, Coder>(symbols, given...);
    case 3:
      return code_rows<3, Coder>(symbols, given...);
    case 4:
      return code_rows<4, Coder>(symbols, given...);
    case 5:
      return code_rows<5, Coder>(symbols, given...);
    case 6:
      return code_rows<6, Coder>(symbols, given...);
    case 7:
      return code_rows<7, Coder>(symbols, given...);
    default:
      return code_rows<8, Coder>(symbols, given...);
  }
}

void put(std::vector<std::uint8_t>& out, std::size_t value, int bytes) {
  for (int i = 0; i < bytes; ++i) out.push_back(static_cast<std::uint8_t>(value >> (8 * i)));
}

std::size_t take(const std::uint8_t* from, int bytes) {
  std::size_t value = 0;
  for (int i = bytes - 1; i >= 0; --i) value = value << 8 | from[i];
  return value;
}

}  // namespace

std::vector<std::uint8_t> encode_intensity(const std::uint8_t* values, const std::uint8_t* returns,
                                           const MaskGeometry& geometry, std::uint32_t turn) {
  if (turn > 65535) throw Error(ErrorCode::Section, "a turn of more than 65535 columns");
  const std::size_t width = geometry.width;
  const MaskLayout layout(geometry);
  const ClosedRows returned(returns, layout, width);
  if (returned.returns == 0) return {};

  std::array<std::size_t, 256> counts{};
  for (std::size_t i = 0; i < kMaskRows * width; ++i) counts[values[i]] += returns[i] != 0;
  Symbols symbols = symbols_of(counts);
  if (symbols.count() == 1) return {kConstant, symbols.value[0]};
  symbols.place();

  const Stream stream = {turn != 0 ? turn : find_turn(layout, returned.cells.data(), width),
                         rate_for(returned.returns)};
  std::vector<std::uint8_t> head;
  BitWriter bits(head);
  code_symbols(bits, symbols);
  bits.finish();
  std::array<Half<WideEncoder>, 2> halves;
  code_rows_of<WideEncoder>(symbols, stream, layout, returned, width, halves, values);
  const std::vector<std::uint8_t>& first = halves[0].coder.finish(halves[0].interval);
  const std::vector<std::uint8_t>& second = halves[1].coder.finish(halves[1].interval);

  std::vector<std::uint8_t> out;
  out.reserve(kHeadBytes + head.size() + first.size() + second.size());
  put(out, kCoded, 1);
  put(out, stream.turn, 2);
  put(out, stream.rate, 2);
  put(out, head.size(), 2);
  put(out, first.size(), 4);
  out.insert(out.end(), head.begin(), head.end());
  out.insert(out.end(), first.begin(), first.end());
  out.insert(out.end(), second.begin(), second.end());
  return out;
}

std::vector<std::uint8_t> decode_intensity(const std::uint8_t* data, std::size_t size, const std::uint8_t* returns,
                                           const MaskGeometry& geometry) {
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
  if (data[0] != kCoded) throw Error(ErrorCode::Section, "intensities of an unknown kind");
  if (size < kHeadBytes) throw Error(ErrorCode::Truncated, "intensities end within their header", size);
  const Stream stream = {static_cast<std::uint32_t>(take(data + 1, 2)), static_cast<std::uint32_t>(take(data + 3, 2))};
  if (stream.rate == 0 || stream.rate > kMaxRate)
    throw Error(ErrorCode::Section, "intensities that learn at a rate beyond the limits", 3);
  const std::size_t head = take(data + 5, 2), first = take(data + 7, 4), rest = size - kHeadBytes;
  if (head > rest || first > rest - head)
    throw Error(ErrorCode::Truncated, "intensities end before their streams do", size);

  Symbols symbols;
  BitReader bits(data + kHeadBytes, head);
  code_symbols(bits, symbols);
  bits.finish();
  if (symbols.count() < 2) throw Error(ErrorCode::Section, "intensities of fewer than two values", kHeadBytes);
  symbols.place();
  const std::uint8_t* streams = data + kHeadBytes + head;
  std::array<Half<WideDecoder>, 2> halves = {Half<WideDecoder>{WideDecoder(streams, first)},
                                             Half<WideDecoder>{WideDecoder(streams + first, rest - head - first)}};
  for (Half<WideDecoder>& half : halves) half.interval = half.coder.start();
  code_rows_of<WideDecoder>(symbols, stream, layout, returned, width, halves, image.data());
  for (const Half<WideDecoder>& half : halves) half.coder.finish(half.interval);
  return image;
}

}  // namespace lidarcodec
