#!/bin/sh
# Builds every native/fuzz/fuzz_*.cpp with libFuzzer, AddressSanitizer and UndefinedBehaviorSanitizer into OUT.
#   native/fuzz/build.sh OUT && OUT/fuzz_mask -runs=100000 -max_len=2048
# CLANGXX names the compiler (libFuzzer needs clang), ONLY the harnesses to build. The core is compiled without Python.
set -e
out=${1:?usage: native/fuzz/build.sh OUT}
here=$(cd "$(dirname "$0")" && pwd)
clangxx=${CLANGXX:-$(command -v clang++-14 || command -v clang++ || { echo "libFuzzer needs clang++: install it, or name it in CLANGXX" >&2; exit 1; })}
flags="-std=c++20 -O2 -g -ffp-contract=off -fno-sanitize-recover=undefined -I$here/../src -I$here"
# Values that are compared are not followed: coded bytes hold no magic numbers, and to follow them takes a third of the time.
checks="-fno-sanitize-coverage=trace-cmp -fsanitize-coverage-ignorelist=$here/parts/not_followed.txt -fsanitize-ignorelist=$here/parts/not_checked.txt"
mkdir -p "$out/core"
for source in $(find "$here/../src" -name '*.cpp'); do
  case $source in */simulator/* | */udp_*) continue ;; esac  # no harness needs these
  object="$out/core/$(basename "$(dirname "$source")")-$(basename "$source" .cpp).o"
  if [ ! "$object" -nt "$source" ] || [ -n "$(find "$here/../src" "$here"/build.sh "$here"/parts/*.txt \( -name '*.hpp' -o -path "$here/*" \) -newer "$object")" ]; then
    echo "$source" "$object"
  fi
done | xargs -r -P "$(nproc)" -n 2 sh -c '"$0" '"$flags"' -fsanitize=fuzzer-no-link,address,undefined '"$checks"' -c "$1" -o "$2"' "$clangxx"
for harness in "$here"/fuzz_*.cpp; do
  name=$(basename "$harness" .cpp) libraries=
  case " ${ONLY:-$name} " in *" $name "*) ;; *) continue ;; esac
  if [ "$name" = fuzz_session ] || [ "$name" = fuzz_others ]; then
    libraries="-I$here/../include -lzstd -lz"
    echo '#include <zlib.h>
#include <zstd.h>' | "$clangxx" -x c++ -fsyntax-only - 2>/dev/null || { echo "$name needs the headers of zstd and zlib: it is left out" >&2; continue; }
  fi
  "$clangxx" $flags -fsanitize=fuzzer,address,undefined $checks "$harness" "$out"/core/*.o $libraries -o "$out/$name"
done
