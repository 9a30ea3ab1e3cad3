"""The documentation, held against the code: what exists has its heading, examples run, links lead somewhere."""

import doctest
import importlib.util
import os
import pkgutil
import re
import shlex
from functools import cache
from pathlib import Path

import pytest

import lidarcodec
from lidarcodec import errors
from lidarcodec.cli import app
from lidarcodec.codecs import table
from lidarcodec.commands.running.options import command_line
from lidarcodec.evaluation.peers import table as peers
from lidarcodec.ratecontrol.curve import has_curve
from lidarcodec.reduction import table as reducers
from lidarcodec.settings import StreamSettings
from tools import tables

ROOT = Path(__file__).resolve().parent.parent
DOCS = ROOT / "docs"
NOTES = ROOT / "research" / "notes"
PAGES = sorted([ROOT / "README.md", ROOT / "CHANGELOG.md", *DOCS.rglob("*.md"), *NOTES.glob("*.md")], key=str)
MODULES = sorted(
    found.name
    for found in pkgutil.walk_packages(lidarcodec.__path__, "lidarcodec.")
    if not found.name.rpartition(".")[2].startswith("_")
)
TRAINED = ("lidarcodec.training.", "lidarcodec.archive.dataset")


def has_examples(name):
    """Whether there is an example in a module: to look for one costs as much as to run most of them."""
    path = ROOT.joinpath(*name.split("."))
    return ">>>" in (path / "__init__.py" if path.is_dir() else path.with_suffix(".py")).read_text()


TARGETS = ["help", "demo", "test", "lint", "check", "bench", "bench-compare", "golden", "fuzz", "soak", "faults"]


@cache
def commands():
    """The command line's, by name; made once, when a test asks."""
    return command_line(app).commands


def headings(page):
    text = re.sub(r"^```.*?^```", "", (DOCS / page).read_text(), flags=re.MULTILINE | re.DOTALL)
    return {line.lstrip("# ").strip() for line in text.splitlines() if line.startswith("#")}


def test_every_command_has_its_heading_and_no_other():
    assert set(commands()) == headings("commands.md") - {"Commands"}


def test_every_setting_has_its_heading_and_no_other():
    fields, found = set(StreamSettings.model_fields), headings("settings.md") - {"Settings"}
    assert not fields - found, f"docs/settings.md needs a section '### NAME' of each of {sorted(fields - found)}"
    assert not found - fields, f"docs/settings.md has sections of no setting: {sorted(found - fields)}"


def test_the_largest_value_of_every_setting_is_reported():
    text = (DOCS / "settings.md").read_text()
    for name, field in StreamSettings.model_fields.items():
        section = text.partition(f"\n### {name}\n")[2].partition("\n### ")[0]
        for limit in (getattr(one, "le", None) for one in field.metadata):
            assert limit is None or re.search(rf"\bto {limit:,g}\b", section), (
                f"docs/settings.md, {name}: say 'to {limit:,g}'"
            )


def test_every_codec_has_its_heading_and_each_of_its_settings_is_explained():
    found = headings("codecs.md")
    text = (DOCS / "codecs.md").read_text()
    for name in table.names():
        assert name in found, f"docs/codecs.md needs a section '## {name}'"
        section = text.partition(f"\n## {name}\n")[2].partition("\n## ")[0]
        for setting in table.codec(name).settings.model_fields:
            assert f"`{setting}`" in section, f"docs/codecs.md does not explain `{setting}` of {name}"


def test_every_reducer_has_its_heading():
    missing = set(reducers.names()) - headings("reduction.md")
    assert not missing, f"docs/reduction.md needs a section '### NAME' of each of {sorted(missing)}"


def test_every_codec_that_was_measured_is_chosen_for_something_or_not():
    text = (DOCS / "choosing.md").read_text()
    table_of_codecs = text.partition("\n## Codec by codec\n")[2].partition("\n## ")[0]
    for name in filter(has_curve, table.names()):
        assert f"\n| [`{name}`](codecs.md#{name}) |" in table_of_codecs, name


@pytest.mark.parametrize("page", sorted(DOCS.rglob("*.md")), ids=lambda page: page.name)
def test_tables_that_repeat_tables_of_the_code_say_the_same(page):
    assert tables.written(page.read_text()) == page.read_text(), "run `make tables`: it writes them"


def test_every_peer_is_named():
    text = (DOCS / "commands.md").read_text()
    for name in peers.names():
        assert f"`{name.removeprefix(peers.PREFIX)}`" in text, name


def test_every_error_stands_in_the_tree_and_the_tree_is_that_of_the_code():
    tree = errors.__doc__.partition("\n\n")[2].strip()
    assert tree in (DOCS / "errors.md").read_text()
    classes = {name for name, found in vars(errors).items() if isinstance(found, type) and issubclass(found, Exception)}
    assert classes == set(re.findall(r"\b\w+Error\b", tree))


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_every_link_leads_somewhere(page):
    text = page.read_text()
    for target in re.findall(r"\]\(([^)\s]+)\)", text):
        if "://" in target:
            continue
        path, _, anchor = target.partition("#")
        found = (page.parent / path).resolve() if path else page
        assert found.exists(), f"{page.name} links {target}"
        if anchor:
            slugs = {
                re.sub(r"[^\w\- ]", "", line.lstrip("# ").strip().lower()).replace(" ", "-")
                for line in found.read_text().splitlines()
                if line.startswith("#")
            }
            assert anchor in slugs, f"{page.name} links {target}"


def shown_commands():
    """Every line of the pages that begins with `lidarcodec`, in a code block."""
    for page in PAGES:
        blocks = re.findall(r"^```[a-z]*\n(.*?)^```|((?:^    .*\n)+)", page.read_text(), flags=re.MULTILINE | re.DOTALL)
        for fenced, indented in blocks:
            for line in (fenced or indented).splitlines():
                words = shlex.split(line, comments=True) if line.strip().startswith(("lidarcodec ", "make ")) else []
                if len(words) > 1:
                    yield page.name, words


@pytest.mark.parametrize(("page", "words"), list(shown_commands()), ids=lambda value: str(value)[:60])
def test_every_command_that_is_shown_exists_with_its_options(page, words):
    if words[0] == "make":
        targets = re.findall(r"^([a-z-]+):", (ROOT / "Makefile").read_text(), flags=re.MULTILINE)
        assert words[1] in targets
        return
    assert words[1] in commands(), f"{page}: {words}"
    command = commands()[words[1]]
    if hasattr(command, "commands"):  # a group, such as `token`
        command = command.commands[words[2]]
    options = {name for parameter in command.params for name in parameter.opts}
    for word in words[2:]:
        if word.startswith("--"):
            assert word.partition("=")[0] in options | {"--help", "--debug"}, f"{page}: {word}"


def test_the_readme_begins_with_the_two_commands():
    text = (ROOT / "README.md").read_text()
    assert "make demo" in text
    assert text.index("make demo") < text.index("make test") < 600


def test_the_python_of_the_readme_runs(capsys):
    blocks = re.findall(r"^```python\n(.*?)^```", (ROOT / "README.md").read_text(), flags=re.MULTILINE | re.DOTALL)
    assert blocks
    for block in blocks:
        exec(compile(block, "README.md", "exec"), {})
    assert capsys.readouterr().out.startswith("(64, 2154) True")


def test_every_target_of_the_makefile_says_what_it_does():
    text = (ROOT / "Makefile").read_text()
    for target in TARGETS:
        assert re.search(rf"^{target}:.*## \S", text, flags=re.MULTILINE), target


def test_nothing_names_the_machine_it_was_written_on():
    told = re.compile(r"/(home|root|Users|tmp|work)/\w")
    for page in [*PAGES, ROOT / "Makefile", ROOT / "pyproject.toml", ROOT / "constraints.txt"]:
        assert not told.search(page.read_text()), page


def test_every_module_can_be_imported():
    for name in MODULES:
        if not name.startswith(TRAINED) or importlib.util.find_spec("torch"):
            importlib.import_module(name)


@pytest.mark.parametrize("name", [name for name in MODULES if has_examples(name)])
def test_the_examples_of_a_module_run(name, tmp_path, monkeypatch):
    if name.startswith(TRAINED):
        pytest.importorskip("torch", reason="it needs torch: the extra `learned` or `torch`")
    module = importlib.import_module(name)
    monkeypatch.chdir(tmp_path)
    for variable in [key for key in os.environ if key.startswith("LIDARCODEC_")]:
        monkeypatch.delenv(variable)
    assert doctest.testmod(module).failed == 0
