// Products of matrices in single precision, of any shape, with sums in one order whatever the processor.
#pragma once
#include <cstddef>

namespace lidarcodec {

// A matrix (rows, columns) in memory: how far apart its rows and its columns are.
struct Strided {
  const float* at;
  std::size_t row, column;
};

// c (m, n) = c + a (m, k) * b (k, n); rows of b and c lie n apart. n a multiple of 8.
void add_product(std::size_t m, std::size_t n, std::size_t k, const Strided& a, const float* b, float* c);

}  // namespace lidarcodec
