"""What the site (mkdocs.yml) needs beyond docs/: links that leave it, anchors like GitHub's, pages of public names and
of notebooks.
"""

from __future__ import annotations

import ast
import logging
import os
import re
import sys
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent.parent
DOCS = ROOT / "docs"
LINK = re.compile(r"\]\(([^)\s#]+)(#[^)\s]+)?\)")
NOTEBOOK = re.compile(r"\]\(([^)\s#:]+)\.ipynb\)")
LOG = logging.getLogger("mkdocs.hooks.lidarcodec")


def slug(text: str, separator: str = "-") -> str:
    """The anchor of a heading as GitHub makes it, and as tests/test_docs.py checks it."""
    return re.sub(r"[^\w\- ]", "", text.strip().lower()).replace(" ", separator)


def links_out(markdown: str, page: Path, repository: str) -> str:
    """The Markdown of a page of docs/ with the links that leave docs/ led to the repository's own pages.

    A file or folder that does not exist stays as it is, with a warning, which ends a strict build.
    """

    def target(link: re.Match[str]) -> str:
        path, anchor = link[1], link[2] or ""
        found = Path(os.path.normpath(page.parent / path))
        if "://" in path or found == DOCS or DOCS in found.parents:
            return link[0]
        if not found.exists():
            LOG.warning("%s links %s, which does not exist", page.relative_to(DOCS), path)
            return link[0]
        kind = "tree" if found.is_dir() else "blob"
        return f"]({repository.rstrip('/')}/{kind}/main/{found.relative_to(ROOT).as_posix()}{anchor})"

    return LINK.sub(target, markdown)


def public_names() -> list[str]:
    """The names of `lidarcodec.__all__`, without importing the package; `__version__` is none to document."""
    tree = ast.parse((ROOT / "lidarcodec" / "__init__.py").read_text())
    for node in tree.body:
        if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "__all__":
            return [name for name in ast.literal_eval(node.value) if not name.startswith("__")]
    raise LookupError("lidarcodec/__init__.py has no __all__")


def reference() -> str:
    """A page with the docstring of each public name; mkdocstrings fills it in."""
    entries = [f"::: lidarcodec.{name}" for name in public_names() if name != "LidarCodecError"]
    return "\n\n".join(
        [
            "# Python names",
            "Every public name of `import lidarcodec`, from its docstring. [Python](python-api.md) has examples that "
            "run; all errors are in [Errors](errors.md).",
            *entries,
            "",
        ]
    )


def on_config(config: Any) -> Any:
    """Anchors as GitHub makes them."""
    config.mdx_configs.setdefault("toc", {})["slugify"] = slug
    return config


def on_files(files: Any, config: Any) -> Any:
    """Add the page of the public names, and a page of each notebook."""
    from mkdocs.structure.files import File

    sys.path.insert(0, str(Path(__file__).parent))
    from notebooks import page_of

    files.append(File.generated(config, "python-reference.md", content=reference()))
    for path in sorted((DOCS / "notebooks").glob("*.ipynb")):
        page, pictures = page_of(path)
        for name, content in {f"{path.stem}.md": page, **pictures}.items():
            files.append(File.generated(config, f"notebooks/{name}", content=content))
    return files


def on_page_markdown(markdown: str, page: Any, config: Any, **_: Any) -> str:
    """Lead links that leave docs/ to the repository, and links to notebooks to their pages."""
    if page.file.src_uri.startswith("notebooks/"):  # but the last link, to the notebook itself
        text, joint, own = markdown.rpartition("[This page as a notebook]")
        markdown = NOTEBOOK.sub(r"](\1.md)", text) + joint + own
    else:
        markdown = NOTEBOOK.sub(r"](\1.md)", markdown)
    return links_out(markdown, DOCS / page.file.src_uri, config.repo_url)
