#!/bin/sh
# Builds the decoder that the page runs (native/wasm) into clients/web/src/decode/worker/decoder.wasm, and writes down
# beside it of which sources it was made: tests/web/test_wasm_build.py compares. Needs clang and lld from version 14 on,
# and a C++ library for WebAssembly; on Debian: clang lld wasi-libc libc++-dev-wasm32 libc++abi-dev-wasm32
# libclang-rt-dev-wasm32 (of the compiler's version: libc++-14-dev-wasm32 ...). CXX_WASM names another clang++.
set -eu
cd "$(dirname "$0")/.."
cxx="${CXX_WASM:-clang++}"
out=clients/web/src/decode/worker
objects="${WASM_OBJECTS:-build/wasm}"

if ! printf '#include <vector>\nstd::vector<int> v;\n' | "$cxx" --target=wasm32-wasi -x c++ -c -o /dev/null - 2>/dev/null; then
  echo "no compiler for WebAssembly here: on Debian 12, apt-get install clang lld wasi-libc libc++-14-dev-wasm32" \
       "libc++abi-14-dev-wasm32 libclang-rt-14-dev-wasm32" >&2
  exit 1
fi

core="base/crc32c base/processor base/sha256 base/utf8 bits/numbers
      images/coder images/following images/heads mask/align mask/coder mask/places mask/stream motion/fixed_angle
      motion/range_history motion/warp motion/warp_surface network/net network/update network/weight_file pco/groups pco/pco
      plane_motion/directions plane_motion/finder plane_motion/moved planes/azimuth_coder planes/intensity_coder planes/keep_coder planes/neighbour predictive/coder predictive/read
      predictive/write ranges/activity sensors/block_model sensors/json sensors/model sensors/model_tables sensors/ouster
      sensors/ouster_metadata sensors/velodyne session/history session/lattice session/message session/outside session/planes
      session/ranges session/sensor session/session session/shelf session/frames/described_sensor session/frames/image_frame session/frames/picture_ranges session/frames/plane_section
      session/frames/rest session/frames/ring_geometry"
sources=$(ls native/wasm/*.cpp; for name in $core; do echo "native/src/$name.cpp"; done)
rm -rf "$objects"
mkdir -p "$objects"

# -O2: as quick as -O3 in the tests of decoding (2.0 to 2.2 s, in turns), and an eighth smaller. -Os where little time is spent.
# __SSE2__: the core's forms for eight numbers at a time, by native/wasm/sse2. -fexceptions: a throw is a call (errors.cpp).
for source in $sources; do
  echo "$source"
done | xargs -P "${JOBS:-2}" -I{} sh -c '
  name=$(basename $(dirname {}))-$(basename {} .cpp)
  case $name in wasm-api | images-heads | images-following | plane_motion-* | motion-fixed_angle | motion-warp | pco-groups | session-* | base-* | frames-* | sensors-* | network-update | network-weight_file | predictive-coder | planes-azimuth_coder | planes-keep_coder | mask-*) level=-Os ;; *) level=-O2 ;; esac
  exec ${CXX_WASM_LAUNCHER:-} '"$cxx"' --target=wasm32-wasi -std=c++20 $level -msimd128 -mbulk-memory -D__SSE2__ -ffp-contract=off \
    -fexceptions -fvisibility=hidden -ffunction-sections -fdata-sections -Wall -Wextra -MMD -MF "'"$objects"'/$name.d" \
    -Inative/wasm/sse2 -Inative/src -Inative/wasm -c {} -o "'"$objects"'/$name.o"'

# At most 512 MiB of memory: a message that would take more is damage.
"$cxx" --target=wasm32-wasi -mexec-model=reactor "$objects"/*.o -o "$out/decoder.wasm" \
  -Wl,--gc-sections,--strip-all,--max-memory=536870912,-z,stack-size=1048576

# The sources, headers too, as the compiler met them.
cat "$objects"/*.d | tr -d '\\' | tr ' ' '\n' | grep '^native/' | sort -u | xargs sha256sum > "$out/decoder.sources"
ls -l "$out/decoder.wasm"
