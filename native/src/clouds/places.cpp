#include "clouds/places.hpp"

#include "base/processor.hpp"

namespace lidarcodec {
namespace {

using Values = std::array<double, Places::kPoints>;

// Loops of few operations each, which compilers make vectors of.
template <class Float, bool kRounded>
[[gnu::always_inline]] inline void find_places(const CloudGeometry& geometry, std::span<const std::int64_t> row,
                                               const std::uint32_t* n, const std::int32_t* k, Places& found) {
  const std::size_t count = row.size();
  Values turns, cosine, sine;
  std::array<Float, Places::kPoints> along, along_m, up, up_m, aside;
  for (std::size_t i = 0; i < count; ++i) {
    const CloudRow& of = geometry.rows[static_cast<std::size_t>(row[i])];
    turns[i] = static_cast<double>(k[i]) + of.turned;
    along[i] = static_cast<Float>(of.along);
    along_m[i] = static_cast<Float>(of.along_m);
    up[i] = static_cast<Float>(of.up);
    up_m[i] = static_cast<Float>(of.up_m);
    aside[i] = static_cast<Float>(of.aside_m);
  }
  const double turn = geometry.turn;
  for (std::size_t i = 0; i < count; ++i) turns[i] /= turn;
  if constexpr (kRounded)
    for (std::size_t i = 0; i < count; ++i) turns[i] = driver_turns(turns[i], kAngleForms[geometry.angles]);
  for (std::size_t i = 0; i < count; ++i) {
    const Turned at = cosine_sine(turns[i]);
    cosine[i] = at.cosine;
    sine[i] = at.sine;
  }
  const auto step = static_cast<Float>(geometry.step_m);
  for (std::size_t i = 0; i < count; ++i) {
    const Float distance = static_cast<Float>(static_cast<std::int32_t>(n[i])) * step;
    const Float rho = along[i] * distance + along_m[i], height = up[i] * distance + up_m[i];
    const auto c = static_cast<Float>(cosine[i]), s = static_cast<Float>(sine[i]);
    const Float x = rho * c - aside[i] * s, y = rho * s + aside[i] * c;
    found.x[i] = x;
    found.y[i] = y;
    found.z[i] = height;
    found.rho[i] = rho;
  }
}

template <class Float, bool kRounded>
void plainly(const CloudGeometry& geometry, std::span<const std::int64_t> row, const std::uint32_t* n,
             const std::int32_t* k, Places& found) {
  find_places<Float, kRounded>(geometry, row, n, k, found);
}

#if defined(LIDARCODEC_AVX2)
template <class Float, bool kRounded>
LIDARCODEC_AVX2 [[gnu::flatten]] void by_avx2(const CloudGeometry& geometry, std::span<const std::int64_t> row,
                                              const std::uint32_t* n, const std::int32_t* k, Places& found) {
  find_places<Float, kRounded>(geometry, row, n, k, found);
}
#endif

template <class Float>
auto chosen(bool rounded) {
#if defined(LIDARCODEC_AVX2)
  if (quickest_path() == Path::Avx2) return rounded ? by_avx2<Float, true> : by_avx2<Float, false>;
#endif
  return rounded ? plainly<Float, true> : plainly<Float, false>;
}

}  // namespace

Places::Places(const CloudGeometry& geometry)
    : geometry_(geometry),
      find_(geometry.narrow ? chosen<float>(geometry.angles != 0) : chosen<double>(geometry.angles != 0)) {}

}  // namespace lidarcodec
