#include "base/processor.hpp"

#if defined(__x86_64__)
#include <cpuid.h>
#endif

#include "base/error.hpp"

namespace lidarcodec {
namespace {

#if defined(__x86_64__)
// All that the AVX2 forms are compiled for. Counting leading zeros has a question of its own: where it is missing, the
// same instruction means something else.
bool has_avx2() {
  unsigned a = 0, b = 0, c = 0, d = 0;
  const bool counts = __get_cpuid(0x80000001u, &a, &b, &c, &d) != 0 && (c & bit_LZCNT) != 0;
  return counts && __builtin_cpu_supports("avx2") && __builtin_cpu_supports("bmi") && __builtin_cpu_supports("bmi2") &&
         __builtin_cpu_supports("popcnt");
}
#endif

}  // namespace

std::vector<Path> paths_here() {
  std::vector<Path> paths = {Path::Plain};
#if defined(__SSE2__) || defined(__aarch64__)
  paths.push_back(Path::Vector);
#endif
#if defined(__x86_64__)
  if (has_avx2()) paths.push_back(Path::Avx2);
#endif
  return paths;
}

const char* name_of(Path path) {
  switch (path) {
    case Path::Plain:
      return "plain";
    case Path::Vector:
#if defined(__aarch64__)
      return "neon";
#else
      return "sse2";
#endif
    case Path::Avx2:
      return "avx2";
  }
  return "";
}

Path path_named(const std::string& name) {
  std::string all;
  for (const Path path : paths_here()) {
    if (name == name_of(path)) return path;
    all += std::string(all.empty() ? "" : ", ") + name_of(path);
  }
  throw Error(ErrorCode::Settings, "no path " + name + " on this processor: it has " + all);
}

}  // namespace lidarcodec
