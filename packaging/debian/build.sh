#!/bin/sh
# Builds the Debian package for vehicles: an environment in /opt/lidarcodec that needs no network, systemd units, a user.
#   packaging/debian/build.sh [WHEEL]      writes build/debian/lidarcodec_VERSION_ARCHITECTURE.deb
# Run it on the distribution and the processor of the vehicle: the package uses that distribution's Python, from 3.11 on.
# Needs python3-venv and dpkg, and without WHEEL also g++ and python3-dev.
#   PYTHON=/usr/bin/python3.12     another Python of the distribution
set -eu
root=$(cd "$(dirname "$0")/../.." && pwd)
out=$root/build/debian
wheel=${1:-}
python=$(readlink -f "${PYTHON:-/usr/bin/python3}")
case $python in /usr/bin/python3.*) ;; *) echo "$python is not the Python of this distribution" >&2; exit 2 ;; esac

work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
"$python" -m venv "$work/tools"
if [ -z "$wheel" ]; then
  "$work/tools/bin/pip" install --quiet --require-hashes -r "$root/requirements/build.txt"
  PATH="$work/tools/bin:$PATH" pip wheel --quiet --no-deps --no-build-isolation --wheel-dir "$work/wheel" "$root"
  wheel=$(echo "$work"/wheel/*.whl)
fi

home=$work/stage/opt/lidarcodec
"$python" -m venv --without-pip "$home"
for what in "--require-hashes -r $root/requirements/debian.txt" "--no-deps $wheel"; do
  # shellcheck disable=SC2086  # words
  "$work/tools/bin/pip" --python "$home/bin/python" install --quiet --no-compile $what
done
sh "$root/packaging/debian/pack.sh" "$work/stage" "$out" "$python"
