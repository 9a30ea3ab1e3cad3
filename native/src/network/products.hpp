// Matrix products in single precision. Sums have one order on all processors.
#pragma once
#include <cstddef>
#include <vector>

namespace lidarcodec {

// A matrix (rows, columns) in memory, with the strides of its rows and columns.
struct Strided {
  const float* at;
  std::size_t row, column;
};

// A range of rows of a matrix; multiples of four if the matrix has pruned tiles.
struct Run {
  std::size_t from, to;
};

// The rows that are not pruned, for each sixteen columns of a matrix.
using Runs = std::vector<std::vector<Run>>;

// c (m, n) += a (m, k) * b (k, n). Rows of b and c are contiguous; n is a multiple of 8.
void add_product(std::size_t m, std::size_t n, std::size_t k, const Strided& a, const float* b, float* c);

// The same for a b that is 0 outside of `runs`, with equal bits.
void add_product_with(const Runs& runs, std::size_t m, std::size_t n, const Strided& a, const float* b, float* c);

// The same, but only for the numbers of c within `runs`.
void add_product_to(const Runs& runs, std::size_t n, std::size_t k, const Strided& a, const float* b, float* c);

}  // namespace lidarcodec
