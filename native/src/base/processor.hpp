// What the processor at hand can do. Inner loops that exist in several forms, with the same results, are chosen by it.
#pragma once
#include <string>
#include <vector>

// What functions are compiled for that run on the path Avx2 only.
#if defined(__x86_64__)
#define LIDARCODEC_AVX2 [[gnu::target("avx2,bmi,bmi2,lzcnt,popcnt")]]
#endif

namespace lidarcodec {

// Plain: C++ alone. Vector: eight numbers of 16 bits at a time, as every x86-64 (SSE2) and every 64-bit ARM (NEON) can.
// Avx2: sixteen.
enum class Path { Plain, Vector, Avx2 };

// Those that this processor can run, the quickest last.
std::vector<Path> paths_here();

inline Path quickest_path() { return paths_here().back(); }

// "plain", "sse2" or "neon", "avx2".
const char* name_of(Path path);

// The path of a name. Raises Settings if this processor cannot run it.
Path path_named(const std::string& name);

// Whether one more thread would find a processor that is free, or nearly: at present no more threads want to run on
// this machine than there are processors for this process. Where that is not known, whether there are two.
bool has_free_processor();

}  // namespace lidarcodec
