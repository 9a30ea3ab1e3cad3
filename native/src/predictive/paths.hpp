// Images of ranges on all paths of the processor, each with and without expected ranges and a network.
#pragma once
#include <array>
#include <cstddef>
#include <cstdint>
#include <type_traits>

#include "predictive/avx2.hpp"
#include "predictive/image.hpp"

namespace lidarcodec {

// Codes rows of an image, (64, W). Reads or writes only their returns.
template <class Forms, bool kExpects, bool kNetwork, class Coder, class Image>
void code_rows(const ImageCoding& on, const RowSource& source, PredictiveParts<Coder>& parts, Image* image) {
  using Rows = PredictiveRows<Coder, Forms, kExpects, kNetwork>;
  const auto step = static_cast<std::int32_t>(source.cells.step);
  Rows coder(on.model, on.network, source.cells, (kMaxRange + kMaxLevel) / step + 1, on.quick, parts);
  RowStage<Rows::kReads, kExpects, kNetwork> stage(source, source.rows.first, coder.start(), coder.first());
  for (std::size_t row = source.rows.first; row < source.rows.end; ++row) {
    coder.code(stage.begin(row, image));
    stage.end(image);
  }
}

// Codes a slab: the columns after the known ones. The rows of the upper and of the lower half are interleaved.
template <class Forms, bool kExpects, bool kNetwork, class Coder, class Image>
void code_slab(const ImageCoding& on, const RowSource& source, PredictiveParts<Coder>& parts, Image* image) {
  using Rows = PredictiveRows<Coder, Forms, kExpects, kNetwork>;
  constexpr std::size_t kHalf = kMaskRows / 2;
  const auto step = static_cast<std::int32_t>(source.cells.step);
  Rows coder(on.model, on.network, source.cells, (kMaxRange + kMaxLevel) / step + 1, on.quick, parts);
  on.states.begin(source.cells, coder.start(), source.past != 0);
  RowStage<Rows::kReads, kExpects, kNetwork> upper(source, 0, coder.start(), coder.first());
  RowStage<Rows::kReads, kExpects, kNetwork> lower(source, kHalf, coder.start(), coder.first());
  for (std::size_t row = 0; row < kHalf; ++row) {
    const RowTask a = upper.begin(row, image), b = lower.begin(row + kHalf, image);
    coder.code(a, on.states.of[row], b, on.states.of[row + kHalf]);
    upper.end(image);
    lower.end(image);
  }
}

// Selects the form and the kind at run time.
template <class Coder, class Image>
void code_image(const ImageCoding& on, const RowSource& source, PredictiveParts<Coder>& parts, Image* image) {
  const auto code = [&]<class Forms>(const Forms&) {
    const auto with = [&](auto expects, auto network) {
      on.slab ? code_slab<Forms, expects.value, network.value>(on, source, parts, image)
              : code_rows<Forms, expects.value, network.value>(on, source, parts, image);
    };
    const bool network = on.network.net != nullptr || on.network.samples != nullptr;
    if (source.expected != nullptr) {
      network ? with(std::true_type{}, std::true_type{}) : with(std::true_type{}, std::false_type{});
    } else {
      network ? with(std::false_type{}, std::true_type{}) : with(std::false_type{}, std::false_type{});
    }
  };
  switch (on.path) {
    case Path::Plain:
#if !defined(__wasm__)  // the page has one path, to be small
      return code(PlainForms{});
#endif
    case Path::Vector:
      return code(VectorForms{});
    case Path::Avx2:
#if defined(__x86_64__)
      return code(Avx2Forms{});
#else
      return code(VectorForms{});
#endif
  }
}

}  // namespace lidarcodec
