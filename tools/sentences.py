"""Every sentence that a user can meet, with its places: errors, warnings, help texts, and errors of the core.

    python tools/sentences.py                        # all of them
    python tools/sentences.py lidarcodec/sources     # those of a folder
    python tools/sentences.py | grep '^[2-9]'        # those that stand in several places

Values stand in braces. A line is: how often, kind, text, places.
"""

from __future__ import annotations

import ast
import re
import sys
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path
from typing import Final

ROOT: Final = Path(__file__).resolve().parent.parent
ROOMS: Final = ("lidarcodec", "server/lidarcodec_server", "native/src", "native/bindings", "native/c")
LOGGED: Final = ("warning", "error", "exception", "critical", "warn")
THROWN: Final = re.compile(r"\b(?:Error|fail|refuse)\((?:ErrorCode::\w+, *)?(.*?)\);", re.DOTALL)
TYPED: Final = re.compile(r"\bOption\(|\btyper\.|: AsJson\b")
DOOR: Final = re.compile(r"(app|router)\.(command|callback|get|post|put|patch|delete)\b")
LITERAL: Final = re.compile(r'"((?:[^"\\]|\\.)*)"')

Found = tuple[int, str, str]
"""Line, kind, text."""


def _text(node: ast.expr | None, constants: dict[str, str]) -> str:
    """The text of an expression, with values in braces; empty if it has no words of its own."""
    match node:
        case ast.Constant(value=str(text)):
            return text
        case ast.JoinedStr(values=parts):
            return "".join(_text(part, constants) for part in parts)
        case ast.FormattedValue(value=ast.Name(id=name)) if name in constants:
            return constants[name]
        case ast.FormattedValue(value=value):
            return "{" + ast.unparse(value) + "}"
        case ast.BinOp(left=left, op=ast.Add(), right=right):
            return _text(left, constants) + _text(right, constants)
        case ast.BinOp(left=left, op=ast.Mod()):
            return _text(left, constants)
        case ast.IfExp(body=body, orelse=orelse):
            return f"{_text(body, constants)} | {_text(orelse, constants)}"
        case ast.Name(id=name):
            return constants.get(name, "{" + name + "}")
        case ast.Call(func=ast.Attribute(value=value, attr="format" | "join")):
            return _text(value, constants)
    return "" if node is None else "{" + ast.unparse(node) + "}"


def _kind(call: ast.Call) -> str:
    """What the texts in a call are: of an error, a warning, help, or something else (empty)."""
    name = call.func.attr if isinstance(call.func, ast.Attribute) else getattr(call.func, "id", "")
    if name.endswith(("Error", "Exception", "Exit", "BadParameter")):
        return "error"
    if name in LOGGED and isinstance(call.func, ast.Attribute):
        return "warning"
    return "help" if name in ("Option", "Argument", "Query", "Path", "Field", "Typer") else ""


def _is_door(function: ast.FunctionDef | ast.AsyncFunctionDef) -> bool:
    """Whether the docstring of a function is help: of a command, or of a route of the server."""
    doors = (ast.unparse(one) for one in function.decorator_list)
    return bool(TYPED.search(ast.unparse(function.args))) or any(DOOR.match(one) for one in doors)


def of_python(path: Path) -> Iterator[Found]:
    """Sentences of a Python file."""
    tree = ast.parse(path.read_text())
    constants = {
        target.id: _text(node.value, {})
        for node in tree.body
        if isinstance(node, ast.Assign | ast.AnnAssign)
        for target in (node.targets if isinstance(node, ast.Assign) else [node.target])
        if isinstance(target, ast.Name) and isinstance(node.value, ast.Constant | ast.JoinedStr)
    }
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef) and _is_door(node):
            yield node.lineno, "help", " ".join((ast.get_docstring(node) or "").split())
        if isinstance(node, ast.Call) and (kind := _kind(node)):
            named = [one.value for one in node.keywords if one.arg in ("help", "description", "detail", "epilog")]
            for value in named if kind == "help" else [*node.args, *named]:
                text = " ".join(_text(value, constants).split())
                if " " in re.sub(r"\{.*?\}", "", text).strip():
                    yield value.lineno, kind, text


def of_core(path: Path) -> Iterator[Found]:
    """Errors of a file in C++."""
    source = path.read_text()
    for thrown in THROWN.finditer(source):
        text = " ".join("{}".join(LITERAL.findall(thrown[1])).split())
        if " " in text:
            yield source.count("\n", 0, thrown.start()) + 1, "error", text


def main(folders: list[str]) -> None:
    """Print the sentences of these folders."""
    places: defaultdict[tuple[str, str], list[str]] = defaultdict(list)
    for folder in folders or ROOMS:
        for path in sorted((ROOT / folder).rglob("*")):
            read = {".py": of_python, ".cpp": of_core, ".hpp": of_core}.get(path.suffix)
            for line, kind, text in read(path) if read else ():
                places[kind, text].append(f"{path.relative_to(ROOT)}:{line}")
    for (kind, text), where in places.items():
        print(f"{len(where)}\t{kind}\t{text}\t{' '.join(where)}")


if __name__ == "__main__":
    main(sys.argv[1:])
