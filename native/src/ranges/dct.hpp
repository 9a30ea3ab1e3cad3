// The orthonormal 8 x 8 discrete cosine transform (DCT-II) of JPEG (ITU-T T.81, A.3.3), on floats. Loops that compilers
// vectorise.
#pragma once
#include <array>
#include <cstddef>

namespace lidarcodec {

inline constexpr std::size_t kSide = 8;
using Block = std::array<float, kSide * kSide>;

namespace dct {

// cos(k pi / 16) for k = 0 to 8, as literals: results of maths libraries differ between machines.
inline constexpr std::array<double, 9> kCosine = {1.0,
                                                  0.98078528040323044913,
                                                  0.92387953251128675613,
                                                  0.83146961230254523708,
                                                  0.70710678118654752440,
                                                  0.55557023301960222474,
                                                  0.38268343236508977173,
                                                  0.19509032201612826785,
                                                  0.0};

constexpr double cosine(std::size_t sixteenths) {
  const std::size_t k = sixteenths % 32;
  if (k <= 8) return kCosine[k];
  if (k <= 16) return -kCosine[16 - k];
  if (k <= 24) return -kCosine[k - 16];
  return kCosine[32 - k];
}

// kBasis[u][x]: value at x of frequency u.
constexpr Block make_basis() {
  Block basis{};
  for (std::size_t u = 0; u < kSide; ++u)
    for (std::size_t x = 0; x < kSide; ++x)
      basis[u * kSide + x] = static_cast<float>((u == 0 ? kCosine[4] : 1.0) / 2 * cosine((2 * x + 1) * u));
  return basis;
}

constexpr Block transposed(const Block& a) {
  Block out{};
  for (std::size_t i = 0; i < kSide; ++i)
    for (std::size_t j = 0; j < kSide; ++j) out[j * kSide + i] = a[i * kSide + j];
  return out;
}

inline constexpr Block kBasis = make_basis();
inline constexpr Block kBasisTransposed = transposed(kBasis);

inline Block product(const Block& a, const Block& b) {
  Block out;
  for (std::size_t i = 0; i < kSide; ++i) {
    std::array<float, kSide> sum{};
    for (std::size_t k = 0; k < kSide; ++k)
      for (std::size_t j = 0; j < kSide; ++j) sum[j] += a[i * kSide + k] * b[k * kSide + j];
    for (std::size_t j = 0; j < kSide; ++j) out[i * kSide + j] = sum[j];
  }
  return out;
}

}  // namespace dct

// Coefficients of a block, vertical frequency by row.
inline Block forward_dct(const Block& x) { return dct::product(dct::product(dct::kBasis, x), dct::kBasisTransposed); }

// The samples of a block from its coefficients.
inline Block inverse_dct(const Block& c) { return dct::product(dct::product(dct::kBasisTransposed, c), dct::kBasis); }

}  // namespace lidarcodec
