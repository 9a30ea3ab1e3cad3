#include "base/processor.hpp"

#if defined(__x86_64__)
#include <cpuid.h>
#endif

#include <cstdio>
#include <memory>
#if !defined(__wasm__)
#include <thread>
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

#if defined(__linux__)
// How many threads of all programs run or want to; 0 if that is not known. proc(5): "1.27 1.30 1.11 2/345 6789", the
// number before the slash.
unsigned runnable_threads() {
  const std::unique_ptr<std::FILE, int (*)(std::FILE*)> file(std::fopen("/proc/loadavg", "re"), &std::fclose);
  unsigned runnable = 0;
  return file != nullptr && std::fscanf(file.get(), "%*s %*s %*s %u/", &runnable) == 1 ? runnable : 0;
}
#elif !defined(__wasm__)
unsigned runnable_threads() { return 0; }
#endif

}  // namespace

bool has_free_processor() {
#if defined(__wasm__)
  return false;
#else
  const unsigned processors = std::thread::hardware_concurrency();
  return processors > 1 && runnable_threads() <= processors;
#endif
}

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
