#!/bin/sh
# Builds every native/fuzz/fuzz_*.cpp with libFuzzer, AddressSanitizer and UndefinedBehaviorSanitizer into OUT.
#   native/fuzz/build.sh OUT && OUT/fuzz_mask -runs=100000 -max_len=2048
# CLANGXX names the compiler (libFuzzer needs clang). The core is compiled without Python.
set -e
out=${1:?usage: native/fuzz/build.sh OUT}
here=$(cd "$(dirname "$0")" && pwd)
clangxx=${CLANGXX:-$(command -v clang++-14 || command -v clang++ || { echo "libFuzzer needs clang++: install it, or name it in CLANGXX" >&2; exit 1; })}
flags="-std=c++20 -O2 -g -ffp-contract=off -fno-sanitize-recover=undefined -I$here/../src -I$here"
mkdir -p "$out/core"
for source in "$here"/../src/*.cpp; do
  object="$out/core/$(basename "$source" .cpp).o"
  if [ ! "$object" -nt "$source" ] || [ -n "$(find "$here/../src" -name '*.hpp' -newer "$object")" ]; then
    echo "$source" "$object"
  fi
done | xargs -r -P "$(nproc)" -n 2 sh -c '"$0" '"$flags"' -fsanitize=fuzzer-no-link,address,undefined -fsanitize-coverage-ignorelist='"$here"'/not_followed.txt -c "$1" -o "$2"' "$clangxx"
for harness in "$here"/fuzz_*.cpp; do
  "$clangxx" $flags -fsanitize=fuzzer,address,undefined "$harness" "$out"/core/*.o -o "$out/$(basename "$harness" .cpp)"
done
