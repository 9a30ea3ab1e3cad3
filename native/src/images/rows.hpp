// The last rows of a plane, as others see them and as its own predictions need them.
#pragma once
#include <algorithm>
#include <array>
#include <bit>
#include <cstddef>
#include <cstdint>
#include <utility>
#include <vector>

namespace lidarcodec {

// Logarithm of a number below 2^24 in quarters of an octave: 0 of 0, 1 of 1, 4 of 4, 8 of 12.
inline std::uint32_t quarter_log(std::uint32_t x) {
  return (std::bit_cast<std::uint32_t>(static_cast<float>(x + 4)) >> 21) - (129u << 2);
}

// A row with a margin on both sides, and the rows above it.
template <class T, std::size_t Count>
class Rows {
 public:
  static constexpr std::size_t kMargin = 4;

  explicit Rows(std::size_t columns, T value = {}) : stride_(columns + 2 * kMargin), store_(Count * stride_, value) {
    for (std::size_t i = 0; i < Count; ++i) row_[i] = store_.data() + i * stride_ + kMargin;
  }
  Rows(const Rows&) = delete;
  Rows& operator=(const Rows&) = delete;

  // The row being coded is row 0, the one above it 1.
  T* operator[](std::size_t row) { return row_[row]; }
  const T* operator[](std::size_t row) const { return row_[row]; }

  // Goes on to the next row. Beyond the ends of the rows above stand their first and last cells, and left of the new
  // row the first cell of the one above it.
  void next(std::size_t columns) {
    T* const done = row_[0];
    std::fill_n(done - kMargin, kMargin, done[0]);
    std::fill_n(done + columns, kMargin, done[columns - 1]);
    std::rotate(row_.begin(), row_.end() - 1, row_.end());
    std::fill_n(row_[0] - kMargin, kMargin, done[0]);
  }

  // Makes the last row the one before it.
  void repeat_last(std::size_t columns) {
    std::copy_n(row_[Count - 2] - kMargin, columns + 2 * kMargin, row_[Count - 1] - kMargin);
  }

 private:
  std::size_t stride_;
  std::vector<T> store_;
  std::array<T*, Count> row_;
};

}  // namespace lidarcodec
