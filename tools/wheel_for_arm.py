"""Builds the wheel for aarch64 on another processor, and tries it there: an emulator runs Debian's Python for arm64.

    python tools/wheel_for_arm.py                    writes build/arm/wheel/lidarcodec-...-linux_aarch64.whl
    python tools/wheel_for_arm.py tests/wire         runs these tests, too

Needs Debian with g++-aarch64-linux-gnu, qemu-user-static and a network, and the version of Python which that Debian has
(3.11 for Debian 12), with what `make` installs. Nothing outside of build/ changes. The folder build/arm is kept:
delete it to begin anew.

The wheel is built as for any processor (pyproject.toml), with a tool chain for CMake. It is installed with its
dependencies' wheels for aarch64; nothing else is compiled. Then:
    tools/try_wheel.py runs commands, as on every machine;
    messages coded there must have the bytes of those that are coded here;
    the golden files of tests/golden must decode there to what they hold.
"""

from __future__ import annotations

import hashlib
import os
import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
FOLDER = ROOT / "build" / "arm"
DEBIAN = FOLDER / "debian"
PYTHON = FOLDER / "environment" / "bin" / "python"
VERSION = f"3.{sys.version_info.minor}"
EMULATOR, COMPILER = "qemu-aarch64-static", "aarch64-linux-gnu-g++"
CODECS = ("raw", "zstd", "pcodec", "predictive", "riddle")
QUIET = ("--quiet", "--disable-pip-version-check", "--only-binary", ":all:")
TESTERS = ("pytest", "pytest-timeout", "pytest-asyncio", "hypothesis")


def main(tests: list[str]) -> None:
    """Raises CalledProcessError if a step fails, SystemExit if something is missing or bytes differ."""
    for program in (COMPILER, EMULATOR, "apt-get", "dpkg-deb"):
        if shutil.which(program) is None:
            sys.exit(f"{program} is not installed")
    if not (DEBIAN / "usr" / "bin" / f"python{VERSION}").exists():
        unpack_debian()
    wheel = build()
    print(f"{wheel.name} needs {', '.join(needed(wheel))}", flush=True)
    if not PYTHON.exists():
        make_environment()
    _pip("--no-index", "--no-deps", "--force-reinstall", wheel)
    _run(sys.executable, "-m", "compileall", "-q", *PYTHON.parents[1].glob("lib/*/site-packages/lidarcodec*"))
    _run(PYTHON, "-P", ROOT / "tools" / "try_wheel.py")
    compare()
    # The package of the checkout must not be found before that of the environment.
    words = ("-q", "-p", "no:cacheprovider", "-o", "pythonpath=", "-o", "timeout=1800", "--import-mode=append")
    _run(PYTHON, "-P", "-m", "pytest", *words, "tests/golden", *tests, cwd=ROOT)


def unpack_debian() -> None:
    """Python of this Debian for arm64, its headers and libraries, from where this machine gets its packages."""
    apt = FOLDER / "apt"
    for part in ("state/lists/partial", "cache/archives/partial", "debs"):
        (apt / part).mkdir(parents=True, exist_ok=True)
    (apt / "state" / "status").touch()
    newer = Path("/etc/apt/sources.list.d/debian.sources")
    (apt / "apt.conf").write_text(
        f'Dir::State "{apt}/state";\nDir::State::status "{apt}/state/status";\nDir::Cache "{apt}/cache";\n'
        f'Dir::Etc::sourcelist "{newer if newer.exists() else "/etc/apt/sources.list"}";\nDir::Etc::sourceparts "-";\n'
        'APT::Architecture "arm64";\nAPT::Architectures { "arm64"; };\n'
    )
    environment = os.environ | {"APT_CONFIG": str(apt / "apt.conf")}
    _run("apt-get", "update", "-qq", env=environment)
    names = [f"python{VERSION}", "libstdc++6"]
    only = [f"--no-{kind}" for kind in ("recommends", "suggests", "conflicts", "breaks", "replaces", "enhances")]
    words = ["apt-cache", "depends", "--recurse", *only, *names]
    listed = subprocess.run(words, env=environment, check=True, capture_output=True, text=True).stdout
    packages = sorted(set(re.findall(r"^[a-z0-9][\w.+-]*$", listed, flags=re.MULTILINE)))
    _run("apt-get", "download", "-qq", *packages, f"libpython{VERSION}-dev", env=environment, cwd=apt / "debs")
    for package in (apt / "debs").glob("*.deb"):
        _run("dpkg-deb", "-x", package, DEBIAN)
    if not (DEBIAN / "lib").exists():  # from Debian 13 on
        (DEBIAN / "lib").symlink_to("usr/lib")
    _run(sys.executable, "-m", "compileall", "-q", DEBIAN / "usr" / "lib" / f"python{VERSION}")


def build() -> Path:
    """The wheel, built by the build of the project with another compiler and the headers of the other Python."""
    tools = FOLDER / "aarch64.cmake"
    headers = DEBIAN / "usr" / "include"
    tools.write_text(
        "set(CMAKE_SYSTEM_NAME Linux)\nset(CMAKE_SYSTEM_PROCESSOR aarch64)\n"
        f"set(CMAKE_CXX_COMPILER {COMPILER})\ninclude_directories(SYSTEM {headers})\n"
        f'set(Python_INCLUDE_DIR {headers}/python{VERSION} CACHE PATH "" FORCE)\n'
    )
    environment = os.environ | {
        "_PYTHON_HOST_PLATFORM": "linux-aarch64",
        "SETUPTOOLS_EXT_SUFFIX": f".cpython-{VERSION.replace('.', '')}-aarch64-linux-gnu.so",
        "CMAKE_ARGS": f"-DCMAKE_TOOLCHAIN_FILE={tools}",
        "PATH": f"{Path(sys.executable).parent}:{os.environ['PATH']}",
    }
    out = FOLDER / "wheel"
    shutil.rmtree(out, ignore_errors=True)
    words = ("wheel", "--quiet", "--no-deps", "--no-build-isolation", "--wheel-dir", out, ROOT)
    _run(sys.executable, "-m", "pip", *words, env=environment)
    (wheel,) = out.glob("*_aarch64.whl")
    return wheel


def needed(wheel: Path) -> list[str]:
    """The newest version that its module needs of each library."""
    with tempfile.TemporaryDirectory() as folder:
        shutil.unpack_archive(wheel, folder, "zip")
        (module,) = Path(folder, "lidarcodec").glob("_native*.so")
        words = [COMPILER.replace("g++", "readelf"), "--version-info", module]
        told = subprocess.run(words, check=True, capture_output=True, text=True).stdout
    newest: dict[str, tuple[int, ...]] = {}
    for name, version in re.findall(r"\b(GLIBC|GLIBCXX|CXXABI)_([\d.]+)", told):
        newest[name] = max(newest.get(name, ()), tuple(map(int, version.split("."))))
    return [f"{name}_{'.'.join(map(str, version))}" for name, version in newest.items()]


def make_environment() -> None:
    """An environment of the emulated Python, with what the package needs and what runs tests."""
    home = PYTHON.parents[1]
    (home / "lib" / f"python{VERSION}" / "site-packages").mkdir(parents=True, exist_ok=True)
    (home / "pyvenv.cfg").write_text(f"home = {DEBIAN}/usr/bin\ninclude-system-site-packages = false\n")
    import pip

    shutil.copytree(Path(pip.__file__).parent, FOLDER / "pip" / "pip", dirs_exist_ok=True)
    made = PYTHON.with_name("made")
    made.parent.mkdir(exist_ok=True)
    made.write_text(f'#!/bin/sh\nexec {EMULATOR} -L {DEBIAN} -0 "$0" {DEBIAN}/usr/bin/python{VERSION} "$@"\n')
    made.chmod(0o755)
    server = ("--require-hashes", "-r", ROOT / "requirements" / "server.txt")
    testers = ("-c", ROOT / "constraints.txt", *TESTERS)
    wheels = FOLDER / "wheels"
    for what in (server, testers):
        _run(sys.executable, "-m", "pip", "download", *QUIET, *_platform(), "--dest", wheels, *what)
        _pip("--no-index", "--find-links", wheels, *what, python=made)
    _run(sys.executable, "-m", "compileall", "-q", home / "lib")
    made.rename(PYTHON)


def _platform() -> list[str]:
    """Options of pip for wheels that the other Python can use: an emulator is slow at finding them."""
    newest = int((os.confstr("CS_GNU_LIBC_VERSION") or "glibc 2.17").rpartition(".")[2])
    tags = ["manylinux2014_aarch64", *(f"manylinux_2_{minor}_aarch64" for minor in range(17, newest + 1))]
    words = ["--python-version", VERSION, "--implementation", "cp"]
    words += [word for abi in (f"cp{VERSION.replace('.', '')}", "abi3", "none") for word in ("--abi", abi)]
    return words + [word for tag in tags for word in ("--platform", tag)]


def _pip(*words: object, python: Path = PYTHON) -> None:
    """Installs as that Python, which refuses what is not for it. Bytecode is left to the quicker Python of here."""
    _run(python, FOLDER / "pip" / "pip", "install", *QUIET, "--no-compile", *words)


def compare() -> None:
    """Whether messages that are coded there have the bytes of those coded here."""
    with tempfile.TemporaryDirectory() as folder:
        drive = Path(folder, "drive.pcap")
        _run(sys.executable, "-m", "lidarcodec", "simulate", "sim:city", drive, "--frames", 2)
        here, there = (
            subprocess.run([python, "-P", __file__, "--hashes", drive], check=True, capture_output=True, text=True)
            for python in (sys.executable, PYTHON)
        )
    print(there.stdout, end="", flush=True)
    if here.stdout != there.stdout:
        sys.exit(f"other bytes than here:\n{here.stdout}")


def hashes(capture: str) -> None:
    """Prints what the messages of a capture are, and the points that come of them, by codec."""
    import lidarcodec

    frames = list(lidarcodec.read_frames(capture))
    for codec in CODECS:
        encoder = lidarcodec.StreamEncoder(lidarcodec.StreamSettings(codec=codec), stream_id=1)
        messages = [one for frame in frames for one in encoder.encode(frame)] + encoder.flush()
        data = [lidarcodec.pack(one) for one in messages]
        print(f"{codec:10} {sum(map(len, data)):8,} bytes {hashlib.sha256(b''.join(data)).hexdigest()}")


def _run(*words: object, env: dict[str, str] | None = None, cwd: Path | None = None) -> None:
    subprocess.run([str(word) for word in words], check=True, env=env, cwd=cwd)


if __name__ == "__main__":
    if sys.argv[1:2] == ["--hashes"]:
        hashes(sys.argv[2])
    else:
        main(sys.argv[1:])
