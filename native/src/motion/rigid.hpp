// Rigid transforms in metres, their update by a small motion, and the linear system of a Gauss-Newton step.
#pragma once
#include <array>
#include <cmath>
#include <cstdint>

#include "motion/beams.hpp"
#include "motion/vectors.hpp"

namespace lidarcodec {

struct Rigid {
  std::array<Vector3, 3> row{{{1, 0, 0}, {0, 1, 0}, {0, 0, 1}}};  // of the rotation matrix
  Vector3 translation;

  Vector3 rotate(const Vector3& p) const { return {dot(row[0], p), dot(row[1], p), dot(row[2], p)}; }
  Vector3 transform(const Vector3& p) const { return rotate(p) + translation; }

  Rigid inverse() const {
    Rigid back;
    back.row = {{{row[0].x, row[1].x, row[2].x}, {row[0].y, row[1].y, row[2].y}, {row[0].z, row[1].z, row[2].z}}};
    back.translation = -1 * back.rotate(translation);
    return back;
  }
};

inline Rigid rigid_of(const Motion& motion) {
  Rigid rigid;
  constexpr double unit = 1.0 / (1 << 30);
  for (std::size_t i = 0; i < 3; ++i)
    rigid.row[i] = {motion.rotation[3 * i] * unit, motion.rotation[3 * i + 1] * unit,
                    motion.rotation[3 * i + 2] * unit};
  rigid.translation = {motion.translation[0] * kLengthM, motion.translation[1] * kLengthM,
                       motion.translation[2] * kLengthM};
  return rigid;
}

inline std::int32_t nearest(double value) {
  return std::abs(value) < 2e9 ? static_cast<std::int32_t>(std::floor(value + 0.5)) : 0;
}

inline Motion motion_of(const Rigid& rigid) {
  Motion motion;
  constexpr double unit = 1 << 30;
  for (std::size_t i = 0; i < 3; ++i) {
    motion.rotation[3 * i] = nearest(rigid.row[i].x * unit);
    motion.rotation[3 * i + 1] = nearest(rigid.row[i].y * unit);
    motion.rotation[3 * i + 2] = nearest(rigid.row[i].z * unit);
  }
  motion.translation = {nearest(rigid.translation.x / kLengthM), nearest(rigid.translation.y / kLengthM),
                        nearest(rigid.translation.z / kLengthM)};
  return motion;
}

// Whether the rows of a rotation matrix have length 1.
inline bool is_orthonormal(const Rigid& rigid) {
  return std::abs(dot(rigid.row[0], rigid.row[0]) - 1) < 1e-6 && std::abs(dot(rigid.row[1], rigid.row[1]) - 1) < 1e-6;
}

// The transform followed by the small rotation vector w and the translation v. The rotation is the Cayley transform
// (1 + [w/2]) (1 - [w/2])^-1, which needs neither sine nor cosine and is a rotation for any w.
inline Rigid updated(const Rigid& rigid, const Vector3& w, const Vector3& v) {
  const Vector3 h = 0.5 * w;
  const double k = 2 / (1 + dot(h, h));
  const auto rotate = [&](const Vector3& p) { return p + k * (cross(h, p) + cross(h, cross(h, p))); };
  const Rigid columns = rigid.inverse();  // its rows are the columns of the rotation
  Rigid out;
  const Vector3 x = rotate(columns.row[0]), y = rotate(columns.row[1]), z = rotate(columns.row[2]);
  out.row = {{{x.x, y.x, z.x}, {x.y, y.y, z.y}, {x.z, y.z, z.z}}};
  out.translation = rotate(rigid.translation) + v;
  return out;
}

// Solves h x = b by Cholesky's decomposition h = L L^T and two substitutions (Golub and Van Loan, Matrix Computations,
// section 4.2); only the lower half of h is read. False: h is not positive definite.
inline bool solve_cholesky(std::array<std::array<double, 6>, 6> h, std::array<double, 6> b, std::array<double, 6>& x) {
  for (std::size_t i = 0; i < 6; ++i) {
    for (std::size_t j = 0; j <= i; ++j) {
      double sum = h[i][j];
      for (std::size_t k = 0; k < j; ++k) sum -= h[i][k] * h[j][k];
      if (i == j) {
        if (!(sum > 1e-9)) return false;
        h[i][i] = std::sqrt(sum);
      } else {
        h[i][j] = sum / h[j][j];
      }
    }
  }
  for (std::size_t i = 0; i < 6; ++i) {
    for (std::size_t k = 0; k < i; ++k) b[i] -= h[i][k] * b[k];
    b[i] /= h[i][i];
  }
  for (std::size_t i = 6; i-- > 0;) {
    x[i] = b[i];
    for (std::size_t k = i + 1; k < 6; ++k) x[i] -= h[k][i] * x[k];
    x[i] /= h[i][i];
  }
  return true;
}

}  // namespace lidarcodec
