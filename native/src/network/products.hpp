// Products of matrices in single precision, of any shape, with sums in one order whatever the processor.
#pragma once
#include <cstddef>
#include <vector>

namespace lidarcodec {

// A matrix (rows, columns) in memory: how far apart its rows and its columns are.
struct Strided {
  const float* at;
  std::size_t row, column;
};

// Rows of a matrix from one up to before another; multiples of four, where they are of a matrix with empty tiles.
struct Run {
  std::size_t from, to;
};

// Which rows of each sixteen columns of a matrix are not empty.
using Runs = std::vector<std::vector<Run>>;

// c (m, n) = c + a (m, k) * b (k, n); rows of b and c lie n apart. n a multiple of 8.
void add_product(std::size_t m, std::size_t n, std::size_t k, const Strided& a, const float* b, float* c);

// The same where b is 0 beside `runs`, to the bit.
void add_product_with(const Runs& runs, std::size_t m, std::size_t n, const Strided& a, const float* b, float* c);

// The same, but only those numbers of c that are within `runs`.
void add_product_to(const Runs& runs, std::size_t n, std::size_t k, const Strided& a, const float* b, float* c);

}  // namespace lidarcodec
