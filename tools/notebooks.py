"""Runs the notebooks of docs/notebooks, and writes what they print and plot into them.

    python tools/notebooks.py [NAME]...      all of them, or live, training and so on

Cells run in this process, without a kernel, as tests/test_notebooks.py runs them too. A cell tagged `times` prints
what differs from run to run.
"""

from __future__ import annotations

import base64
import contextlib
import io
import json
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

ROOT = Path(__file__).resolve().parent.parent
NOTEBOOKS = ROOT / "docs" / "notebooks"
DOTS_AN_INCH: Final = 80
Cell = dict[str, Any]


def read(name: str) -> dict[str, Any]:
    """A notebook by its name."""
    found: dict[str, Any] = json.loads((NOTEBOOKS / f"{name}.ipynb").read_text())
    return found


def names() -> list[str]:
    """All notebooks."""
    return sorted(path.stem for path in NOTEBOOKS.glob("*.ipynb"))


def code_cells(notebook: dict[str, Any]) -> list[Cell]:
    """Its cells of code, in order."""
    return [cell for cell in notebook["cells"] if cell["cell_type"] == "code"]


def ran(notebook: dict[str, Any], name: str) -> Iterator[tuple[Cell, str, list[bytes]]]:
    """Each cell of code after it ran: what it printed, and its figures as PNG."""
    import matplotlib as mpl

    mpl.use("Agg")
    import matplotlib.pyplot as plt

    names_in_it: dict[str, Any] = {"__name__": "__main__"}
    for number, cell in enumerate(code_cells(notebook), 1):
        printed = io.StringIO()
        code = compile("".join(cell["source"]), f"{name}.ipynb, cell {number}", "exec")
        with contextlib.redirect_stdout(printed):
            exec(code, names_in_it)
        figures = []
        for figure in map(plt.figure, plt.get_fignums()):
            picture = io.BytesIO()
            figure.savefig(picture, format="png", dpi=DOTS_AN_INCH, metadata={"Software": None})
            figures.append(picture.getvalue())
        plt.close("all")
        yield cell, printed.getvalue(), figures


def printed_in(cell: Cell) -> str:
    """What a cell of a written notebook printed."""
    return "".join("".join(one["text"]) for one in cell["outputs"] if one["output_type"] == "stream")


def figures_in(cell: Cell) -> list[bytes]:
    """Its figures as PNG."""
    return [base64.b64decode(one["data"]["image/png"]) for one in cell["outputs"] if "data" in one]


def write(name: str) -> None:
    """Run a notebook, and write it with its outputs."""
    notebook = read(name)
    for number, (cell, text, figures) in enumerate(ran(notebook, name), 1):
        cell["execution_count"] = number
        stream = {"name": "stdout", "output_type": "stream", "text": text.splitlines(keepends=True)}
        cell["outputs"] = [stream] if text else []
        for picture in figures:
            data = {"image/png": base64.b64encode(picture).decode()}
            cell["outputs"].append({"data": data, "metadata": {}, "output_type": "display_data"})
    text = json.dumps(notebook, indent=1, sort_keys=True, ensure_ascii=False)
    (NOTEBOOKS / f"{name}.ipynb").write_text(f"{text}\n")


if __name__ == "__main__":
    for one in sys.argv[1:] or names():
        write(one)
        print(f"{one}: written")
