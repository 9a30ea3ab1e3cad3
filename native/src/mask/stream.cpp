#include "mask/stream.hpp"

#include <algorithm>

#include "base/error.hpp"
#include "bits/rangecoder.hpp"
#include "mask/avx2.hpp"
#include "mask/coder.hpp"
#include "mask/windows.hpp"

namespace lidarcodec {
namespace {

struct PlainMaskForms {
  using Odds = PlainLogOdds;

  template <std::size_t count>
  static void look_up(const std::array<const std::uint8_t*, count>& from, const std::vector<std::uint16_t>& at,
                      const CellGroups&, const std::array<std::uint8_t*, count>& to) {
    look_up_each(from, at.data(), 0, at.size(), to);
  }

  static void put(const std::uint8_t* values, const DirectionGroups& picks, std::size_t shift, std::uint8_t* to) {
    put_groups(values, picks, shift, to, [](const std::uint8_t* cells, const std::uint8_t* behind, std::uint8_t* at) {
      for (std::size_t i = 0; i < DirectionGroups::kGroup; ++i) at[i] = cells[behind[i]];
    });
  }

  template <class Work>
  static void run(const Work& work) {
    work();
  }
};

// Codes a row whose windows were computed.
template <class Forms, class Bits>
void code_row(Bits& bits_so_far, MaskModel& model, const MaskWindows& windows, std::uint8_t* cells, std::size_t n) {
  Bits bits = bits_so_far;  // this and the next ones are local copies, so that compilers keep them in registers
  std::int32_t remainder = model.remainder();
  BitModel* const gates = model.gates();
  const std::uint16_t* const gate_numbers = windows.gate.data();
  using Odds = typename Forms::Odds;
  Odds odds(model.cells());
  typename Odds::Block block;
  std::size_t known = n;  // the block whose context numbers are computed
  LeftCells left;
  for (std::size_t k = 0; k < n; ++k) {
    BitModel& gate = gates[gate_numbers[k] | left.hole_class() << 6 | (left.bits & 1u) << 8];
    std::uint32_t probability = gate.probability();
    const bool sure = MaskModel::sure(probability);
    if (!sure) {
      if (known != k / kContextBlock) {
        known = k / kContextBlock;
        Forms::run([&windows, &block, known] {
          ContextBlock numbers;
          windows.number_contexts(known * kContextBlock, numbers);
          Odds::put_block(numbers, block);
        });
      }
      probability = MaskModel::probability(odds.sum(block, k % kContextBlock, left));
    }
    const auto learn = [&](bool bit) {
      if (!sure) odds.move(MaskModel::move(bit, probability, remainder));
      gate.update(bit);
      if constexpr (Bits::kReads) cells[k] = bit;
      left.take(bit);
    };
    // A branch, so that the processor predicts the bit and goes on.
    if (bits.bit(cells[k], probability))
      learn(true);
    else
      learn(false);
  }
  odds.end();
  model.remainder() = remainder;
  bits_so_far = bits;
}

}  // namespace

template <class Bits>
void MaskStream::code_on_path(const Bits& bits, const MaskView& view, std::uint8_t* rows) {
#if defined(__x86_64__)
  if (path_ == Path::Avx2) return code<Avx2MaskForms>(bits, view, rows);
#endif
  code<PlainMaskForms>(bits, view, rows);
}

template <class Forms, class Bits>
void MaskStream::code(Bits bits, const MaskView& view, std::uint8_t* rows) {
  MaskFrame frame(view, places_);
  const MaskLayout& layout = frame.layout();
  const std::size_t width = view.geometry.width;
  MaskWindows windows(width);
  PaddedRowOf<std::uint16_t> expected(width + MaskWindows::kRoom);
  for (std::size_t row = 0; row < kMaskRows; ++row) {
    const std::size_t n = layout.cells(row);
    if (n == 0) continue;
    std::uint16_t* const range = expected.cells();
    const std::vector<std::uint32_t>& columns = layout.columns(row);
    if (view.expected != nullptr) {
      const std::uint16_t* const from = view.expected + row * width;
      if (layout.whole(row))
        std::copy_n(from, n, range);
      else
        for (std::size_t k = 0; k < n; ++k) range[k] = from[columns[k]];
      expected.pad(n);
    }
    frame.begin_row(row, range);
    Forms::run([&] { windows.template begin_row<Forms>(frame, row, n, view.expected == nullptr ? nullptr : range); });

    std::uint8_t* const cells = rows + row * width;
    Forms::run([&] { code_row<Forms>(bits, model_, windows, cells, n); });
    frame.template put<Forms>(cells, windows.here, windows.place, fresh_);
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
  code_on_path(bits, view, closed.cells.data());
  return out;
}

std::vector<std::uint8_t> MaskStream::decode(const std::uint8_t* data, std::size_t size, const MaskView& view) {
  if (size == 0) throw Error(ErrorCode::Truncated, "a mask section holds no bytes");
  if (data[0] != kMaskBegins && data[0] != kMaskGoesOn)
    throw Error(ErrorCode::Section, "a mask section of an unknown kind");
  if (data[0] == kMaskGoesOn && !begun_)
    throw Error(ErrorCode::Section, "a mask section needs those of earlier frames");
  begin(data[0] == kMaskBegins);
  const MaskLayout layout(view.geometry);
  std::vector<std::uint8_t> rows(kMaskRows * view.geometry.width);
  BitReader bits(data + 1, size - 1);
  code_on_path(bits, view, rows.data());
  return layout.opened(rows);
}

}  // namespace lidarcodec
