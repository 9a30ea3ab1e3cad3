"""What a vehicle would lose if the Debian package were wrong: its recordings, its keys, or a service that starts."""

from __future__ import annotations

import gzip
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tests.conftest import ROOT

HERE = ROOT / "packaging" / "debian"
UNITS = sorted(path.name for path in (ROOT / "packaging").glob("lidarcodec-*.[st]*"))


@pytest.fixture(scope="module")
def package(tmp_path_factory):
    """The package with an environment that holds nothing but the command, unpacked: its files and its control files."""
    if shutil.which("dpkg-deb") is None:
        pytest.skip("needs dpkg-deb")
    folder = tmp_path_factory.mktemp("debian")
    home = folder / "stage" / "opt" / "lidarcodec"
    (home / "bin").mkdir(parents=True)
    (home / "lib" / "python3.11" / "site-packages" / "lidarcodec-1.2.3.dist-info").mkdir(parents=True)
    (home / "bin" / "lidarcodec").write_text(f"#!{home}/bin/python3\n")
    (home / "bin" / "activate").write_text("")
    library = home / "lib" / "python3.11" / "site-packages" / "some.libs" / "libsome-1.so.2"
    library.parent.mkdir()
    library.write_bytes(b"")
    library.chmod(0o755)
    (home / "pyvenv.cfg").write_text(f"home = {home}\n")
    words = ["sh", HERE / "pack.sh", folder / "stage", folder, sys.executable]
    subprocess.run(words, check=True, timeout=100, stdout=subprocess.DEVNULL)
    (made,) = folder.glob("lidarcodec_*.deb")
    subprocess.run(["dpkg-deb", "-R", made, folder / "files"], check=True, timeout=60)
    return folder / "files"


def test_the_version_is_that_of_what_is_in_it(package):
    """apt upgrades by it."""
    assert "\nVersion: 1.2.3\n" in (package / "DEBIAN" / "control").read_text()


def test_the_command_does_not_know_where_it_was_built(package):
    home = package / "opt" / "lidarcodec"
    assert (home / "bin" / "lidarcodec").read_text() == "#!/opt/lidarcodec/bin/python3\n"
    assert (home / "pyvenv.cfg").read_text() == "home = /opt/lidarcodec\n"
    assert not (home / "bin" / "activate").exists()
    assert (package / "usr" / "bin" / "lidarcodec").readlink() == Path("/opt/lidarcodec/bin/lidarcodec")


def test_the_units_are_those_of_the_repository_and_find_what_the_package_brings(package):
    found = package / "lib" / "systemd" / "system"
    assert sorted(path.name for path in found.iterdir()) == UNITS
    user = (package / "usr" / "lib" / "sysusers.d" / "lidarcodec.conf").read_text()
    for unit in found.glob("*.service"):
        text = unit.read_text()
        assert re.search(r"^ExecStart=/opt/lidarcodec/bin/lidarcodec ", text, flags=re.MULTILINE), unit
        (name,) = re.findall(r"^User=(.*)$", text, flags=re.MULTILINE)
        assert f"u {name} " in user


def test_an_upgrade_asks_before_it_replaces_a_configuration_and_no_key_is_shipped(package):
    shipped = {f"/etc/lidarcodec/{path.name}" for path in (package / "etc" / "lidarcodec").iterdir()}
    assert shipped == set((package / "DEBIAN" / "conffiles").read_text().split())
    assert shipped == {"/etc/lidarcodec/environment", "/etc/lidarcodec/publish.yaml"}
    assert not (package / "var").exists()


def test_recordings_and_keys_stay_when_the_package_goes(package, tmp_path):
    kept = [tmp_path / "var/lib/lidarcodec/roof/0.mcap", tmp_path / "etc/lidarcodec/zenoh.json5"]
    for path in kept:
        path.parent.mkdir(parents=True)
        path.write_text("mine")
    for script, what in (("prerm", "remove"), ("postrm", "remove"), ("postrm", "purge")):
        words = ["sh", package / "DEBIAN" / script, what]
        done = subprocess.run(
            words, env=os.environ | {"DPKG_ROOT": str(tmp_path)}, check=True, timeout=60, capture_output=True, text=True
        )
    assert [path.read_text() for path in kept] == ["mine", "mine"]
    assert done.stdout.splitlines() == [f"{path} stays, with what you keep there" for path in
                                        (tmp_path / "etc/lidarcodec", tmp_path / "var/lib/lidarcodec")]  # fmt: skip


def test_libraries_are_no_programs(package):
    """Wheels bring them with the right to be executed, which checkers of packages refuse."""
    (library,) = package.rglob("*.so.2")
    assert library.stat().st_mode & 0o777 == 0o644


def test_apt_can_show_what_changed(package):
    """It reads the form of Debian's changelogs, which must name the version that is installed."""
    folder = package / "usr" / "share" / "doc" / "lidarcodec"
    text = gzip.decompress((folder / "changelog.gz").read_bytes()).decode()
    when = r"\w{3}, \d\d \w{3} \d{4} [\d:]{8} \+0000"
    assert re.fullmatch(rf"lidarcodec \(1\.2\.3\) \S+; urgency=\S+\n\n  \* .+\n\n -- .+ <\S+>  {when}\n", text)
    assert gzip.decompress((folder / "CHANGELOG.md.gz").read_bytes()) == (ROOT / "CHANGELOG.md").read_bytes()


def test_every_file_has_its_sum(package):
    summed = {line.split("  ", 1)[1] for line in (package / "DEBIAN" / "md5sums").read_text().splitlines()}
    files = {path for path in package.rglob("*") if path.is_file() and not path.is_symlink()}
    assert summed == {path.relative_to(package).as_posix() for path in files if "DEBIAN" not in path.parts}


@pytest.mark.parametrize("script", ["build.sh", "pack.sh", "postinst", "prerm", "postrm"])
def test_the_scripts_are_plain_shell(script):
    subprocess.run(["sh", "-n", HERE / script], check=True, timeout=60)


def test_the_readme_tells_only_of_files_that_are_there():
    text = (HERE / "README.Debian").read_text()
    named = set(re.findall(r"lidarcodec-(?:publish|serve|subscribe|push)\b", text))
    assert named == {Path(name).stem.rstrip("@") for name in UNITS}
