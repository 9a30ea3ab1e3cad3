#include "mask_stream.hpp"

#include <algorithm>

#include "error.hpp"
#include "mask_coder.hpp"
#include "mask_windows.hpp"
#include "rangecoder.hpp"

namespace lidarcodec {
namespace {

// The cells to the left.
struct LeftCells {
  std::uint32_t bits = ~0u;   // the last one lowest
  std::uint32_t holes = 0;    // among the last 12
  std::uint32_t run = 0;      // equal ones before the last one

  void take(bool bit) {
    run = bit == (bits & 1u) ? std::min(run + 1, 7u) : 0;
    holes = holes + !bit - (~bits >> 11 & 1u);
    bits = bits << 1 | static_cast<std::uint32_t>(bit);
  }
  std::uint32_t few() const { return holes < 2 ? holes : holes < 4 ? 2 : 3; }
};

}  // namespace

template <class Bits>
void MaskStream::code(Bits& bits, const MaskView& view, std::uint8_t* rows) {
  MaskFrame frame(view, places_);
  const MaskLayout& layout = frame.layout();
  const std::size_t width = view.geometry.width;
  MaskWindows windows(width);
  PaddedRowOf<std::uint16_t> expected(width);
  for (std::size_t row = 0; row < kMaskRows; ++row) {
    const std::size_t n = layout.cells(row);
    if (n == 0) continue;
    std::uint16_t* const range = expected.cells();
    const std::vector<std::uint32_t>& columns = layout.columns(row);
    if (view.expected != nullptr) {
      for (std::size_t k = 0; k < n; ++k) range[k] = view.expected[row * width + columns[k]];
      expected.pad(n);
    }
    frame.begin_row(row, range);
    windows.look(frame, row, n, view.expected == nullptr ? nullptr : range);

    std::uint8_t* const cells = rows + row * width;
    const std::uint16_t* const gates = windows.gate.data();
    std::array<const std::uint16_t*, kCellContexts> known;
    for (std::size_t i = 0; i < kCellContexts; ++i) known[i] = windows.contexts[i].data();
    LeftCells left;
    for (std::size_t k = 0; k < n; ++k) {
      const std::uint32_t l1 = left.bits & 1u;
      BitModel& gate = model_.gate(gates[k] | left.few() << 6 | l1 << 8);
      const std::uint32_t sure = gate.probability();
      bool bit;
      if (MaskModel::sure(sure)) {
        bit = bits.bit(cells[k], sure);
      } else {
        const std::uint32_t l2 = left.bits >> 1 & 1u, holes = kCountClass[left.holes];
        CellContexts contexts;  // each begins with the cell to the left; further ones where there is room for them
        for (std::size_t i = 0; i < kCellContexts; ++i) contexts[i] = known[i][k] + l1;
        contexts[0] += l2 << 6;
        contexts[1] += left.run << 8;
        contexts[2] += l2 << 9;
        contexts[5] += l2 << 2;
        contexts[10] += holes << 8;
        contexts[13] += (holes << 3) + (left.run << 10);
        contexts[14] += l2 << 10;
        bit = model_.code(bits, cells[k], contexts);
      }
      gate.update(bit);
      if constexpr (Bits::kReads) cells[k] = bit;
      left.take(bit);
    }
    frame.put(cells, windows.here, windows.place, fresh_);
  }
  frame.end();
  bits.finish();
}

void MaskStream::begin(bool fresh) {
  fresh_ = fresh;
  begun_ = true;
  if (!fresh) return;
  places_.forget();
  model_.forget();
}

std::vector<std::uint8_t> MaskStream::encode(const std::uint8_t* mask, const MaskView& view) {
  const MaskLayout layout(view.geometry);
  ClosedRows closed(mask, layout, view.geometry.width);
  if (closed.returns == 0 || closed.returns == closed.fired) return {closed.returns == 0 ? kMaskNone : kMaskAll};
  std::vector<std::uint8_t> out = {begun_ ? kMaskGoesOn : kMaskBegins};
  begin(!begun_);
  BitWriter bits(out);
  code(bits, view, closed.cells.data());
  return out;
}

std::vector<std::uint8_t> MaskStream::decode(const std::uint8_t* data, std::size_t size, const MaskView& view) {
  if (size == 0) throw Error(ErrorCode::Truncated, "a mask section holds no bytes");
  if (data[0] != kMaskBegins && data[0] != kMaskGoesOn) throw Error(ErrorCode::Section, "a mask section of an unknown kind");
  if (data[0] == kMaskGoesOn && !begun_) throw Error(ErrorCode::Section, "a mask section needs those of earlier frames");
  begin(data[0] == kMaskBegins);
  const MaskLayout layout(view.geometry);
  const std::size_t width = view.geometry.width;
  std::vector<std::uint8_t> rows(kMaskRows * width), mask(kMaskRows * width);
  BitReader bits(data + 1, size - 1);
  code(bits, view, rows.data());
  for (std::size_t row = 0; row < kMaskRows; ++row) {
    const std::uint8_t* from = rows.data() + row * width;
    for (const std::uint32_t column : layout.columns(row)) mask[row * width + column] = *from++;
  }
  return mask;
}

}  // namespace lidarcodec
