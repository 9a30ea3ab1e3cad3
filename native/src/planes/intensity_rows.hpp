// Rows of intensities: the order of coding, and the updates of models.
#pragma once
#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>
#include <type_traits>
#include <utility>
#include <vector>

#include "base/error.hpp"
#include "bits/cells.hpp"
#include "bits/wide_coder.hpp"
#include "planes/intensity_model.hpp"

namespace lidarcodec {

// The returns of a row: their cells, and the no-return cells around each.
struct RowReturns {
  std::size_t count = 0;
  std::vector<std::uint32_t> cell;
  std::vector<std::uint8_t> gap, edges, before;  // as in Surroundings

  explicit RowReturns(std::size_t width) : cell(width + 1), gap(width + 1), edges(width + 1), before(width + 1) {}

  // row: the n fired cells of a row of a mask.
  void find(const std::uint8_t* row, std::size_t n) {
    std::uint32_t* to_cell = cell.data();
    std::uint8_t *to_gap = gap.data(), *to_edges = edges.data();
    std::size_t found = 0;
    std::uint32_t since = 0, left = 1;
    for (std::size_t k = 0; k < n; ++k) {
      const std::uint32_t is = row[k], after = k + 1 < n ? row[k + 1] : 1u;
      to_cell[found] = static_cast<std::uint32_t>(k);
      to_gap[found] = static_cast<std::uint8_t>(std::min(since, 3u));
      to_edges[found] = static_cast<std::uint8_t>(3u - 2 * left - after);
      found += is;
      since = is ? 0 : since + 1;
      left = is;
    }
    count = found;
  }
};

// One half of each row: its coder and its state.
template <class Coder>
struct Half {
  Coder coder;
  WideInterval interval{};
  std::array<std::uint8_t, 4> last{};  // symbols, the latest first
  std::size_t next = 0;                // index of the next return of the row
};

// Codes rows of symbols; `Coder` is WideEncoder or WideDecoder. The two halves of a row alternate, symbol by symbol.
template <int Most, bool Follows, class Coder>
class RowCoder {
 public:
  static constexpr bool kReads = std::is_same_v<Coder, WideDecoder>;
  using Halves = std::array<Half<Coder>, 2>;

  // taught: cells to go on from, or none.
  RowCoder(const Symbols& symbols, std::vector<Cells>&& taught, std::uint32_t rate, Halves& halves)
      : symbols_(symbols),
        model_(symbols, std::move(taught)),
        rate_(static_cast<std::int16_t>(rate)),
        halves_(halves) {}

  std::vector<Cells> give_cells() { return model_.give_cells(); }

  // Writes or reads the symbols of the returns of a row. above: the row above, aligned with this one, with its margin;
  // ended: the last symbols of the row in the section before this one, or nullptr. Raises Section or Truncated.
  void code(std::size_t row, const RowReturns& returns, const std::uint8_t* above,
            const std::array<std::uint8_t, 4>* ended, std::uint8_t* symbols) {
    const std::size_t n = returns.count, half = (n + 1) / 2;
    if constexpr (Follows) model_.begin_row(row);
    for (std::size_t h = 0; h < 2; ++h) {
      const std::size_t first = h == 0 ? 0 : half;
      halves_[h].next = first;
      if (h == 0 && ended != nullptr)
        halves_[h].last = *ended;
      else if (first < n)
        halves_[h].last.fill(above[returns.cell[first]]);
      if constexpr (!kReads) halves_[h].coder.make_room(half * static_cast<std::size_t>(symbols_.depth));
    }
    for (std::size_t i = half; i < n; ++i) step<2>(returns, above, symbols);
    if (n % 2 != 0) step<1>(returns, above, symbols);
    if (unknown_) throw Error(ErrorCode::Section, "an intensity that the section does not list");
  }

 private:
  using Model = IntensityModel<Most, Follows>;
  template <std::size_t N, class T>
  using Each = std::array<T, N>;  // for each half that codes a symbol

  // The next symbol of the first N halves.
  template <std::size_t N>
  LIDARCODEC_EACH_RETURN void step(const RowReturns& returns, const std::uint8_t* above, std::uint8_t* symbols) {
    Each<N, typename Model::Named> cells;
    Each<N, WideInterval> interval;
    Each<N, std::uint32_t> leaf{}, way;
    for (std::size_t h = 0; h < N; ++h) {
      const Half<Coder>& half = halves_[h];
      const std::uint32_t cell = returns.cell[half.next];
      cells[h] = model_.contexts({half.last.data(), above + cell, returns.gap[half.next], returns.edges[half.next],
                                  returns.before[half.next]});
      interval[h] = half.interval;
      if constexpr (!kReads) leaf[h] = symbols_.leaf[symbols[cell]];
    }
    const int second = model_.second_levels();
    walk<Model::kFirst, Model::kFirstCells>(cells, interval, model_.first_levels(), second, leaf, way);
    if constexpr (Model::kHasSecond) {
      Each<N, std::uint32_t> first = way;
      for (std::size_t h = 0; h < N; ++h)
        for (Cells*& cell : cells[h]) cell += Model::kFirstCells + Model::kSecondCells * first[h];
      walk<Model::kSecond, Model::kSecondCells>(cells, interval, second, 0, leaf, way);
      for (std::size_t h = 0; h < N; ++h) way[h] += first[h] << second;
    }
    for (std::size_t h = 0; h < N; ++h) {
      Half<Coder>& half = halves_[h];
      const std::uint16_t symbol = symbols_.of_leaf[way[h]];
      unknown_ |= symbol == kNoSymbol;
      half.interval = interval[h];
      half.last = {static_cast<std::uint8_t>(symbol), half.last[0], half.last[1], half.last[2]};
      symbols[returns.cell[half.next++]] = half.last[0];
    }
  }

  // Codes `levels` decisions of each of N leaves, which have `below` further bits; `way` gets the decisions.
  // Probabilities are computed before and models updated after all of them, so both halves may share a cell.
  // Levels: their number if it is known beforehand, else 0.
  template <int Levels, std::uint32_t Vectors, std::size_t N>
  LIDARCODEC_EACH_RETURN void walk(const Each<N, typename Model::Named>& cells, Each<N, WideInterval>& interval,
                                   int given, int below, const Each<N, std::uint32_t>& leaf,
                                   Each<N, std::uint32_t>& way) {
    const int levels = Levels != 0 ? Levels : given;
    Each<N, std::array<Cells, Vectors>> p;
    alignas(16) Each<N, std::array<std::int16_t, 8 * Vectors>> chance;
    Each<N, std::uint32_t> node;
    for (std::size_t h = 0; h < N; ++h) {
      const typename Model::Named& c = cells[h];
      for (std::uint32_t v = 0; v < Vectors; ++v) {
        Cells sum = ((c[0][v] + c[1][v]) + (c[2][v] + c[3][v])) + ((c[4][v] + c[5][v]) + c[6][v]);
        if constexpr (Follows) sum = sum + (c[7][v] + c[8][v]);
        p[h][v] = probabilities(sum);
        p[h][v].store(chance[h].data() + 8 * v);
      }
      node[h] = 1;
    }
    LIDARCODEC_UNROLL(4)
    for (int level = 0; level < levels; ++level) {
      LIDARCODEC_UNROLL(2)
      for (std::size_t h = 0; h < N; ++h) {
        const auto probability = static_cast<std::uint32_t>(chance[h][node[h]]);
        std::uint32_t bit;
        if constexpr (kReads) {
          bit = halves_[h].coder.decode(interval[h], probability);
        } else {
          bit = leaf[h] >> (below + levels - 1 - level) & 1u;
          halves_[h].coder.encode(interval[h], bit, probability);
        }
        node[h] = 2 * node[h] + bit;
      }
    }
    for (std::size_t h = 0; h < N; ++h) {
      const Walk& walked = kWalks[node[h]];
      for (std::uint32_t v = 0; v < Vectors; ++v) {
        const Cells by =
            moves(Cells::load(walked.wanted.data() + 8 * v), Cells::load(walked.taken.data() + 8 * v), p[h][v], rate_);
        for (Cells* cell : cells[h]) cell[v] = cell[v] + by;
      }
      way[h] = node[h] - (1u << levels);
    }
  }

  const Symbols& symbols_;
  Model model_;
  std::int16_t rate_;
  Halves& halves_;
  bool unknown_ = false;
};

}  // namespace lidarcodec
