#!/bin/sh
# Builds the native module in place (lidarcodec/_native*.so), for work on the code. PYTHON names the interpreter;
# further arguments go to cmake, for example -DLIDARCODEC_SANITIZE=ON with BUILD=build/asan.
set -e
cd "$(dirname "$0")/.."
PYTHON=${PYTHON:-.venv/bin/python}
BUILD=${BUILD:-build/native}
TARGET=${TARGET:-lidarcodec}
PATH="$(dirname "$PYTHON"):$PATH"
cmake -S . -B "$BUILD" -G Ninja -DPython_EXECUTABLE="$("$PYTHON" -c 'import sys; print(sys.executable)')" -DLIDARCODEC_C=AUTO "$@" >/dev/null
cmake --build "$BUILD"
mkdir -p "$TARGET"
# Renamed into place: overwriting a module that a running process has mapped would crash it.
for module in "$BUILD"/_native*.so; do
  cp "$module" "$TARGET/.new-module" && mv -f "$TARGET/.new-module" "$TARGET/${module##*/}"
done
# The types of the module, where a developer's tools are there.
if [ "$TARGET" = lidarcodec ] && "$PYTHON" -c 'import nanobind, ruff' 2>/dev/null; then
  "$PYTHON" tools/native_stub.py
fi
