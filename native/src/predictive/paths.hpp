// Images of ranges on all paths of the processor, each with and without what is expected and what was learned.
#pragma once
#include <array>
#include <cstddef>
#include <cstdint>
#include <type_traits>

#include "predictive/avx2.hpp"
#include "predictive/image.hpp"

namespace lidarcodec {

// Codes all rows of an image, (64, W); only returns are looked at, or written.
template <class Forms, bool kExpects, bool kLearned, class Coder, class Image>
void code_rows(const ImageCoding& on, const RowSource& source, PredictiveParts<Coder>& parts, Image* image) {
  using Rows = PredictiveRows<Coder, Forms, kExpects, kLearned>;
  const auto step = static_cast<std::int32_t>(source.cells.step);
  Rows coder(on.model, on.teaching, source.cells, (kMaxRange + kMaxLevel) / step + 1, on.quick, parts);
  RowStage<Rows::kReads, kExpects, kLearned> stage(source, 0, coder.start(), coder.first());
  for (std::size_t row = 0; row < kMaskRows; ++row) {
    coder.code(stage.begin(row, image));
    stage.end(image);
  }
}

// Codes a slab: the columns behind those that are known. Rows of the upper and the lower half of the image in turns.
template <class Forms, bool kExpects, bool kLearned, class Coder, class Image>
void code_slab(const ImageCoding& on, const RowSource& source, PredictiveParts<Coder>& parts, Image* image) {
  using Rows = PredictiveRows<Coder, Forms, kExpects, kLearned>;
  constexpr std::size_t kBoth = kMaskRows / 2;
  const auto step = static_cast<std::int32_t>(source.cells.step);
  Rows coder(on.model, on.teaching, source.cells, (kMaxRange + kMaxLevel) / step + 1, on.quick, parts);
  on.states.begin(source.cells, coder.start(), source.past != 0);
  RowStage<Rows::kReads, kExpects, kLearned> upper(source, 0, coder.start(), coder.first());
  RowStage<Rows::kReads, kExpects, kLearned> lower(source, kBoth, coder.start(), coder.first());
  for (std::size_t row = 0; row < kBoth; ++row) {
    const RowWork a = upper.begin(row, image), b = lower.begin(row + kBoth, image);
    coder.code(a, on.states.of[row], b, on.states.of[row + kBoth]);
    upper.end(image);
    lower.end(image);
  }
}

// Codes a whole frame or a slab on a path, with or without what is expected.
template <class Coder, class Image>
void code_image(const ImageCoding& on, const RowSource& source, PredictiveParts<Coder>& parts, Image* image) {
  const auto code = [&]<class Forms>(const Forms&) {
    const auto with = [&](auto expects, auto learned) {
      on.slab ? code_slab<Forms, expects.value, learned.value>(on, source, parts, image)
              : code_rows<Forms, expects.value, learned.value>(on, source, parts, image);
    };
    const bool learned = on.teaching.net != nullptr || on.teaching.samples != nullptr;
    if (source.expected != nullptr) {
      learned ? with(std::true_type{}, std::true_type{}) : with(std::true_type{}, std::false_type{});
    } else {
      learned ? with(std::false_type{}, std::true_type{}) : with(std::false_type{}, std::false_type{});
    }
  };
  switch (on.path) {
    case Path::Plain:
#if !defined(__wasm__)  // a page has one path: what is not there need not be fetched
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
