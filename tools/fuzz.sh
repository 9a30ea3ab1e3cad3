#!/bin/sh
# `make fuzz`: hostile bytes under AddressSanitizer and UndefinedBehaviorSanitizer.
#   1. each harness of native/fuzz against the C++ core: by libFuzzer where there is a clang, from valid extremes on
#      (tests/fuzz/native_seeds.py); else by random bytes
#   2. every codec, shape, content, bound and intensity through encoder and decoder, by the module as it is installed
#   3. tests/fuzz against the whole decoder, with the native module built with the sanitizers
# CASES and SEED set how much of 3 is run, SECONDS_EACH how long each harness of 1 runs (0: no limit), RUNS how many cases at
# most, MAX_LEN their longest input; ONLY names some of them; ROUND_TRIPS=0 leaves out 2.
set -eu
cd "$(dirname "$0")/.."
PYTHON=${PYTHON:-.venv/bin/python}
CASES=${CASES:-100000}
SEED=${SEED:-1}
SECONDS_EACH=${SECONDS_EACH:-60}
FLAGS="-std=c++20 -pthread -O1 -g -fno-omit-frame-pointer -ffp-contract=off -fno-sanitize-recover=undefined -Inative/src"
mkdir -p build/fuzz

fuzzing_clang() {
  echo 'extern "C" int LLVMFuzzerTestOneInput(const unsigned char*, unsigned long) { return 0; }' >build/fuzz/probe.cpp
  for found in ${CLANG:-} clang++ clang++-20 clang++-19 clang++-18 clang++-17 clang++-16 clang++-15 clang++-14; do
    if command -v "$found" >/dev/null && "$found" -fsanitize=fuzzer,address build/fuzz/probe.cpp -o build/fuzz/probe 2>/dev/null; then
      echo "$found"
      return
    fi
  done
}

clang=$(fuzzing_clang)
if [ -n "$clang" ]; then
  CLANGXX=$clang native/fuzz/build.sh build/fuzz
  rm -rf build/fuzz/seeds
  "$PYTHON" -m tests.fuzz.corpus --only-native --seed "$SEED" build/fuzz/seeds
fi
for harness in native/fuzz/fuzz_*.cpp; do
  [ -e "$harness" ] || continue
  name=$(basename "$harness" .cpp)
  case " ${ONLY:-$name} " in *" $name "*) ;; *) continue ;; esac
  echo "== $name"
  libraries='' longest=4096
  if [ "$name" = fuzz_session ] || [ "$name" = fuzz_others ]; then
    libraries="-Inative/include -lzstd -lz" longest=24000
    if ! echo '#include <zlib.h>
#include <zstd.h>' | "${clang:-${CXX:-c++}}" -x c++ -fsyntax-only - 2>/dev/null; then
      echo "(left out: it needs the headers of zstd and zlib)"
      continue
    fi
  fi
  if [ -n "$clang" ]; then
    mkdir -p "build/fuzz/corpus-$name"
    # Little memory kept back and short traces of where it came from: a case takes half the time. A crash is best run again without.
    ASAN_OPTIONS=${ASAN_OPTIONS:-quarantine_size_mb=8:malloc_context_size=1:allocator_release_to_os_interval_ms=-1} \
    "build/fuzz/$name" -max_total_time="$SECONDS_EACH" ${RUNS:+-runs="$RUNS"} -max_len="${MAX_LEN:-$longest}" -entropic=0 \
      -rss_limit_mb=2048 -timeout=10 -print_final_stats=1 \
      -artifact_prefix="crash-$name-" "build/fuzz/corpus-$name" "build/fuzz/seeds/$name" 2>"build/fuzz/$name.log" || { tail -60 "build/fuzz/$name.log"; exit 1; }
    grep -E "number_of_executed_units|peak_rss" "build/fuzz/$name.log"
  else
    # shellcheck disable=SC2086
    "${CXX:-c++}" $FLAGS -fsanitize=address,undefined "$harness" native/fuzz/driver.cpp $(find native/src -name '*.cpp') $libraries -o "build/fuzz/$name"
    "build/fuzz/$name" "$SECONDS_EACH" "$SEED"
  fi
done
[ -n "$clang" ] || echo "(no clang with libFuzzer here: the harnesses ran on random bytes, without its guidance)"

if [ "${ROUND_TRIPS:-1}" != 0 ]; then
  echo "== round trips"
  "$PYTHON" -m tests.fuzz.round_trips
fi

echo "== decoder, $CASES cases, seed $SEED"
rm -rf build/asan-package && mkdir -p build/asan-package
cp -r lidarcodec tests build/asan-package/
rm -f build/asan-package/lidarcodec/_native*.so
CXX=${GCC:-g++} PYTHON=$PYTHON BUILD=build/asan TARGET=build/asan-package/lidarcodec tools/build-native.sh -DLIDARCODEC_SANITIZE=ON >build/fuzz/asan-build.log
runtime="$(g++ -print-file-name=libasan.so):$(g++ -print-file-name=libubsan.so)"
python=$(cd "$(dirname "$PYTHON")" && pwd)/$(basename "$PYTHON")
cd build/asan-package
LD_PRELOAD="$runtime" ASAN_OPTIONS=detect_leaks=0:quarantine_size_mb=16:allocator_may_return_null=1 \
  UBSAN_OPTIONS=print_stacktrace=1 "$python" -m tests.fuzz.run --cases "$CASES" --seed "$SEED"
