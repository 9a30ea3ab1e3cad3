#include "layers/range_refiner.hpp"

#include <algorithm>
#include <array>
#include <cstdlib>

#include "base/error.hpp"
#include "layers/place_model.hpp"
#include "mask/rows.hpp"

namespace lidarcodec {
namespace {

constexpr std::int32_t kMaxLevel = 1000;
constexpr std::int32_t kNowhere = 2500;  // the range of rows above the first return
constexpr std::int32_t kFirstError = 96;

using Row = std::vector<std::int32_t>;

// A prediction from differences to the base by weights that learn: the normalised least mean squares algorithm.
class Predictor {
 public:
  static constexpr std::size_t kInputs = 11;
  using Inputs = std::array<std::int64_t, kInputs>;

  // Sixteenths of a range step.
  std::int64_t predict(const Inputs& inputs) const {
    std::int64_t sum = 0;
    for (std::size_t i = 0; i < kInputs; ++i) sum += weights_[i] * inputs[i];
    return sum >> 12;
  }

  // error: of what was predicted, in sixteenths, kept within a limit.
  void learn(const Inputs& inputs, std::int64_t error) {
    std::int64_t energy = 256;
    for (const std::int64_t input : inputs) energy += input * input;
    const std::int64_t gain = (error << 24) / energy;
    for (std::size_t i = 0; i < kInputs; ++i)
      weights_[i] = std::clamp<std::int64_t>(weights_[i] + (gain * inputs[i] >> 16), -kMost, kMost);
  }

 private:
  static constexpr std::int64_t kMost = 1 << 20;
  // 65536 is 1.
  std::array<std::int64_t, kInputs> weights_ = {22000, 20000, 4000, 0, 0, 2000, -6000, 3000, 3000, 3000, -2000};
};

// Rows as the next one sees them: cells that are no returns take what is to their left.
struct Rows {
  Row ranges, base, errors;
};

// Codes all returns of an image. `code`: of the row, a column, the model and what is known, gives the range.
template <class Coder>
class Refiner {
 public:
  Refiner(const LayerImage& image, const LayerSteps& steps, Coder& coder)
      : image_(image),
        steps_(steps),
        coder_(coder),
        layout_(image.geometry),
        half_(static_cast<std::int32_t>(steps.base / 2)),
        cells_(cells_of(steps)),
        model_(cells_, steps.fine) {}

  void run() {
    const std::size_t width = image_.geometry.width;
    Rows above{Row(width), Row(width), Row(width)}, here = above;
    PaddedRowOf<std::int32_t> ranges(width), errors(width);
    for (std::size_t row = 0; row < kMaskRows; ++row) {
      if (row != 0) {
        const std::int64_t shift = layout_.shift(row - 1, row, steps_.turn);
        layout_.align(above.ranges.data(), row - 1, row, shift, ranges, kNowhere);
        layout_.align(above.errors.data(), row - 1, row, shift, errors, kFirstError);
      }
      code_row(row, row != 0, ranges.cells(), errors.cells(), here);
      std::swap(above, here);
    }
  }

  // The smallest odd number of cells that covers a step of the base.
  static std::uint32_t cells_of(const LayerSteps& steps) { return ((steps.base + steps.fine - 1) / steps.fine) | 1; }

 private:
  void code_row(std::size_t row, bool has_above, const std::int32_t* above, const std::int32_t* above_errors,
                Rows& out) {
    const std::vector<std::uint32_t>& columns = layout_.columns(row);
    const std::size_t width = image_.geometry.width;
    const std::int32_t level = image_.level[row];
    const std::uint16_t* const of_row = image_.base + row * width;
    returns_.clear();
    for (std::uint32_t k = 0; k < columns.size(); ++k)
      if (of_row[columns[k]] != 0) returns_.push_back(k);
    const auto base_at = [&](std::size_t i) { return of_row[columns[returns_[i]]] + level; };

    const std::int32_t reach = 2 * half_ + 6;
    const std::size_t count = returns_.size();
    std::int32_t before[3] = {};
    std::int64_t mean_error = kFirstError, apart = 0;
    for (std::size_t i = 0; i < count; ++i) {
      const std::ptrdiff_t k = returns_[i];
      const std::int32_t base = base_at(i);
      if (i == 0) std::fill_n(before, 3, base);
      const std::int32_t left = i > 0 ? base_at(i - 1) : base, left2 = i > 1 ? base_at(i - 2) : left;
      const std::int32_t right = i + 1 < count ? base_at(i + 1) : base, right2 = i + 2 < count ? base_at(i + 2) : right;
      const auto near = [&](std::int32_t value) -> std::int64_t {
        const std::int32_t by = value - base;
        return std::abs(by) > reach ? 0 : by;
      };
      const auto level_apart = static_cast<std::int32_t>(apart >> 4);
      const auto up = [&](std::ptrdiff_t by) { return has_above ? above[k + by] + level_apart : base; };
      const std::int32_t above_here = up(0), above_right = up(1);
      const typename Predictor::Inputs inputs = {near(before[0]),   near(before[1]), near(before[2]), near(above_here),
                                                 near(above_right), near(up(-1)),    near(left),      near(right),
                                                 near(right2),      near(up(2)),     near(left2)};
      const std::int64_t most = 16 * (std::int64_t{half_} + 4);
      const std::int64_t predicted = std::clamp(predictor_.predict(inputs), -most, most);

      // Mirrored, so that the prediction never lies below the base.
      const std::int64_t sign = predicted < 0 ? -1 : 1;
      Known known;
      known.predicted = predicted * sign;
      known.left = 16 * sign * near(before[0]);
      known.above = 16 * sign * near(above_here);
      known.between = 8 * sign * (near(left) + near(right));
      const std::int64_t around = has_above ? std::int64_t{above_errors[k]} + above_errors[k + 1] : 2 * mean_error;
      known.scale = std::min(size_class(static_cast<std::uint64_t>((2 * mean_error + around) / 4)), 23u);
      const std::int64_t trend = std::int64_t{before[0] - before[1]} * sign * 3 / half_;
      known.left_trend =
          2 * static_cast<std::uint32_t>(std::clamp<std::int64_t>(trend + 3, 0, 7)) + (near(before[0]) != 0);
      known.above_slope =
          std::abs(above_here - base) > reach
              ? 7u
              : std::min(size_class(4 * static_cast<std::uint64_t>(std::abs(above_here - above_right))) / 2, 6u);
      const auto side = [&](std::int32_t value) { return value == base ? 1u : (value > base) == (sign > 0) ? 2u : 0u; };
      known.sides = 3 * side(left) + side(right);

      const std::int32_t range = code_cell(row, columns[returns_[i]], known, base, level, sign);
      const std::int64_t error = 16 * std::int64_t{range - base} - predicted;
      const std::int64_t limit = 8 * std::int64_t{half_} + 64;
      predictor_.learn(inputs, std::clamp(error, -limit, limit));
      mean_error += (std::abs(error) - mean_error) / 4;
      if (has_above) {
        const std::int64_t now = 16 * std::int64_t{range - above[k]};
        if (i == 0 || std::abs(now - apart) > 16 * (half_ + 5))
          apart = now;
        else
          apart += (now - apart) * 11 / 32;
      }
      out.ranges[static_cast<std::size_t>(k)] = range;
      out.errors[static_cast<std::size_t>(k)] = static_cast<std::int32_t>(std::abs(error));
      before[2] = before[1];
      before[1] = before[0];
      before[0] = range;
      if (i == 0) before[1] = before[2] = range;
    }
    fill(columns.size(), has_above, above, above_errors, out);
  }

  std::int32_t code_cell(std::size_t row, std::uint32_t column, const Known& known, std::int32_t base,
                         std::int32_t level, std::int64_t sign) {
    const std::size_t at = row * image_.geometry.width + column;
    const auto fine = static_cast<std::int32_t>(steps_.fine), middle = static_cast<std::int32_t>(cells_ / 2);
    const auto cell_of = [&](std::int32_t range) {
      const std::int32_t from = (range + level - base) + (2 * middle + 1) * fine / 2;
      const std::int32_t cell = from / fine;
      return static_cast<std::uint32_t>(sign < 0 ? 2 * middle - cell : cell);
    };
    const std::uint32_t coded = coder_.cell(model_, known, at, base - level, half_, cell_of);
    const std::int32_t cell =
        sign < 0 ? 2 * middle - static_cast<std::int32_t>(coded) : static_cast<std::int32_t>(coded);
    const std::int32_t place = std::clamp((cell - middle) * fine, -half_, half_);
    const std::int32_t range = std::clamp(base - level + place, 1, 65535);
    coder_.found(at, static_cast<std::uint16_t>(range));
    return range + level;
  }

  void fill(std::size_t cells, bool has_above, const std::int32_t* above, const std::int32_t* above_errors, Rows& out) {
    if (returns_.empty()) {
      for (std::size_t k = 0; k < cells; ++k) {
        out.ranges[k] = has_above ? above[k] : kNowhere;
        out.errors[k] = has_above ? above_errors[k] : kFirstError;
      }
      return;
    }
    std::size_t from = returns_[0];
    for (std::size_t k = 0, i = 0; k < cells; ++k) {
      if (i < returns_.size() && returns_[i] == k) from = returns_[i++];
      out.ranges[k] = out.ranges[from];
      out.errors[k] = out.errors[from];
    }
  }

  const LayerImage& image_;
  const LayerSteps steps_;
  Coder& coder_;
  const MaskLayout layout_;
  const std::int32_t half_;
  const std::uint32_t cells_;
  PlaceModel model_;
  Predictor predictor_;
  std::vector<std::uint32_t> returns_;
};

struct Writer {
  const std::uint16_t* ranges;
  WideEncoder out;
  WideInterval interval;

  template <class CellOf>
  std::uint32_t cell(PlaceModel& model, const Known& known, std::size_t at, std::int32_t base, std::int32_t half,
                     const CellOf& cell_of) {
    const std::int32_t range = ranges[at];
    if (range == 0 || std::abs(range - base) > half)
      throw Error(ErrorCode::Section, "a range is further from its base than half a step");
    const std::uint32_t wanted = cell_of(range);
    return model.code(known, [&](std::uint32_t p, std::uint32_t middle) {
      const std::uint32_t bit = wanted >= middle;
      out.encode(interval, bit, p);
      return bit;
    });
  }
  void found(std::size_t, std::uint16_t) {}
};

struct Reader {
  WideDecoder in;
  WideInterval interval;
  std::vector<std::uint16_t> ranges;

  template <class CellOf>
  std::uint32_t cell(PlaceModel& model, const Known& known, std::size_t, std::int32_t, std::int32_t, const CellOf&) {
    return model.code(known, [&](std::uint32_t p, std::uint32_t) { return in.decode(interval, p); });
  }
  void found(std::size_t at, std::uint16_t range) { ranges[at] = range; }
};

void check(const LayerImage& image, const LayerSteps& steps) {
  const auto odd = [](std::uint32_t step) { return step % 2 == 1 && step <= kMaxLayerStep; };
  if (!odd(steps.base) || !odd(steps.fine) || steps.fine >= steps.base || steps.turn > 65535)
    throw Error(ErrorCode::Section, "a refinement goes from one odd step to a smaller one, both up to 20001");
  for (std::size_t row = 0; row < kMaskRows; ++row)
    if (image.level[row] < 0 || image.level[row] > kMaxLevel)
      throw Error(ErrorCode::Section, "levels of rows are 0 to 1000");
  for (std::size_t row = 0; row < kMaskRows; ++row) {
    const std::uint8_t* fired = image.geometry.fired + image.geometry.half[row] * image.geometry.width;
    for (std::size_t column = 0; column < image.geometry.width; ++column)
      if (!fired[column] && image.base[row * image.geometry.width + column] != 0)
        throw Error(ErrorCode::Section, "a base has a return in a block that did not fire");
  }
}

}  // namespace

std::vector<std::uint8_t> encode_refinement(const LayerImage& image, const std::uint16_t* ranges,
                                            const LayerSteps& steps) {
  check(image, steps);
  Writer writer{ranges, {}, {}};
  std::size_t returns = 0;
  for (std::size_t i = 0; i < kMaskRows * image.geometry.width; ++i) returns += image.base[i] != 0;
  if (returns == 0) return {};
  writer.out.make_room(returns * 16);  // 20,001 cells are told apart by 15 decisions
  Refiner<Writer>(image, steps, writer).run();
  return writer.out.finish(writer.interval);
}

std::vector<std::uint16_t> decode_refinement(const std::uint8_t* data, std::size_t size, const LayerImage& image,
                                             const LayerSteps& steps) {
  check(image, steps);
  const std::size_t cells = kMaskRows * image.geometry.width;
  Reader reader{WideDecoder(data, size), {}, std::vector<std::uint16_t>(cells)};
  if (std::all_of(image.base, image.base + cells, [](std::uint16_t range) { return range == 0; })) {
    if (size != 0) throw Error(ErrorCode::Section, "refined ranges where there are no returns");
    return reader.ranges;
  }
  reader.interval = reader.in.start();
  Refiner<Reader>(image, steps, reader).run();
  reader.in.finish(reader.interval);
  return reader.ranges;
}

}  // namespace lidarcodec
