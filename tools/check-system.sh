#!/bin/sh
# Names what the machine lacks, all of it at once, before anything is installed. PYTHON names the interpreter.
PYTHON=${PYTHON:-python3}
CXX=${CXX:-c++}
missing=0
lack() {
  [ $missing -eq 0 ] && echo "This machine lacks something that the build needs:" >&2
  missing=1
  echo "  - $1" >&2
}

if ! "$PYTHON" -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null; then
  found=$("$PYTHON" --version 2>&1) || found="no $PYTHON"
  lack "Python 3.11 or newer (found: $found). Name another one with: make PYTHON=/path/to/python3.12"
else
  "$PYTHON" -c 'import venv, ensurepip' 2>/dev/null ||
    lack "Python's venv module (Debian, Ubuntu: apt install python3-venv)"
  "$PYTHON" -c 'import pathlib, sys, sysconfig; sys.exit(not (pathlib.Path(sysconfig.get_path("include")) / "Python.h").exists())' ||
    lack "Python's C headers, Python.h (Debian, Ubuntu: apt install python3-dev; Fedora: dnf install python3-devel)"
fi

probe=$(mktemp -d)
printf '#include <concepts>\n#include <span>\nint main() { std::span<int> s; return static_cast<int>(s.size()); }\n' >"$probe/probe.cpp"
if ! command -v "$CXX" >/dev/null 2>&1; then
  lack "a C++ compiler (Debian, Ubuntu: apt install g++; Fedora: dnf install gcc-c++), or name yours with: make CXX=clang++"
elif ! "$CXX" -std=c++20 -c "$probe/probe.cpp" -o "$probe/probe.o" 2>/dev/null; then
  lack "a C++ compiler that knows C++20, such as gcc 11 or clang 14 ($CXX does not)"
fi
rm -rf "$probe"
exit $missing
