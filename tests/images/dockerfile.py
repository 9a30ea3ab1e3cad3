"""A Dockerfile as stages of instructions, as far as ours go; what it cannot read it refuses.

>>> [stage] = parse('FROM scratch AS one\\nRUN echo a \\\\\\n    && echo b\\n')
>>> stage.name, stage.base, stage.instructions[0]
('one', 'scratch', Instruction(name='RUN', value='echo a     && echo b', line=2))
"""

from __future__ import annotations

import fnmatch
import json
import re
import shlex
from dataclasses import dataclass, field
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent.parent
DOCKERFILE = ROOT / "docker" / "Dockerfile"
KNOWN = {
    "ARG", "CMD", "COPY", "ENTRYPOINT", "ENV", "EXPOSE", "HEALTHCHECK",
    "LABEL", "RUN", "STOPSIGNAL", "USER", "VOLUME", "WORKDIR",
}  # fmt: skip


@dataclass(frozen=True)
class Instruction:
    """One instruction; `value` is on one line."""

    name: str
    value: str
    line: int

    @property
    def words(self) -> list[str]:
        """The value as a JSON list where it is one, else as words of a shell."""
        return json.loads(self.value) if self.value.startswith("[") else shlex.split(self.value)

    @property
    def pairs(self) -> dict[str, str]:
        """NAME=VALUE of ENV, LABEL and ARG; an ARG may have no value."""
        return {name: value for name, _, value in (word.partition("=") for word in shlex.split(self.value))}


@dataclass
class Stage:
    """From one FROM to the next."""

    name: str
    base: str
    instructions: list[Instruction] = field(default_factory=list)

    def all(self, name: str) -> list[Instruction]:
        """Its instructions of that name."""
        return [one for one in self.instructions if one.name == name]

    def last(self, name: str) -> Instruction | None:
        """The one that counts."""
        return next(iter(reversed(self.all(name))), None)


@dataclass(frozen=True)
class Copy:
    """What a COPY says; `stage` is None for the build's context."""

    stage: str | None
    sources: tuple[str, ...]
    destination: str


def copied(instruction: Instruction) -> Copy:
    """Raises ValueError for a flag other than --from."""
    words = instruction.words
    flags = dict(word.removeprefix("--").partition("=")[::2] for word in words if word.startswith("--"))
    if unknown := set(flags) - {"from"}:
        raise ValueError(f"line {instruction.line}: COPY with {unknown}")
    *sources, destination = [word for word in words if not word.startswith("--")]
    return Copy(flags.get("from"), tuple(sources), destination)


def expand(text: str, variables: dict[str, str]) -> str:
    """$NAME and ${NAME} replaced; what is not known is empty, as in a build."""
    return re.sub(r"\$(?:\{(\w+)\}|(\w+))", lambda found: variables.get(found[1] or found[2], ""), text)


def parse(text: str) -> list[Stage]:
    """Raises ValueError for what is no instruction, or one that is not known here."""
    stages: list[Stage] = []
    variables: dict[str, str] = {}
    for line, name, value in _logical(text):
        if name == "FROM":
            found = re.fullmatch(r"(\S+)(?:\s+AS\s+([\w-]+))?", expand(value, variables), re.IGNORECASE)
            if found is None:
                raise ValueError(f"line {line}: FROM {value}")
            stages.append(Stage(found[2] or str(len(stages)), found[1]))
        elif name not in KNOWN:
            raise ValueError(f"line {line}: {name}")
        elif stages:
            stages[-1].instructions.append(Instruction(name, value, line))
        elif name == "ARG":
            variables |= Instruction(name, value, line).pairs
        else:
            raise ValueError(f"line {line}: {name} before the first FROM")
    return stages


def _logical(text: str) -> list[tuple[int, str, str]]:
    """Line number, instruction and value; comments and continued lines are put away."""
    found, parts, begun = [], [], 0
    for number, line in enumerate(text.splitlines(), 1):
        if line.lstrip().startswith("#") or (not line.strip() and not parts):
            continue
        begun = begun or number
        more = line.endswith("\\")
        parts.append(line[:-1] if more else line)
        if not more:
            name, _, value = "".join(parts).strip().partition(" ")
            found.append((begun, name.upper(), value.strip()))
            parts, begun = [], 0
    if parts:
        raise ValueError(f"line {begun}: it never ends")
    return found


class Ignored:
    """What a .dockerignore leaves out of the build's context. The last pattern that fits decides."""

    def __init__(self, text: str) -> None:
        self._patterns = [line.strip() for line in text.splitlines() if line.strip() and not line.startswith("#")]

    def __call__(self, path: str) -> bool:
        """path: relative to the context, with slashes"""
        out = False
        for pattern in self._patterns:
            keep = pattern.startswith("!")
            bare = pattern.removeprefix("!").strip("/")
            parts = path.split("/")
            above = ["/".join(parts[: number + 1]) for number in range(len(parts))]
            if bare.startswith("**/"):
                fits = any(fnmatch.fnmatchcase(part, bare[3:]) for part in parts)
            else:
                fits = any(fnmatch.fnmatchcase(one, bare) for one in above if one.count("/") == bare.count("/"))
            if fits:
                out = not keep
        return out


def context() -> list[str]:
    """Files of this checkout that a build gets, relative to it."""
    ignored = Ignored((ROOT / ".dockerignore").read_text())
    found: list[str] = []

    def look(folder: Path) -> None:
        for path in sorted(folder.iterdir()):
            name = path.relative_to(ROOT).as_posix()
            if path.is_dir():
                if name.split("/")[0] not in {".git", ".venv", "build"}:
                    look(path)
            elif not ignored(name):
                found.append(name)

    look(ROOT)
    return found
