"""Makes a page of the site of a notebook: its text, its code, what this printed, and its pictures."""

from __future__ import annotations

import base64
import json
from pathlib import Path


def page_of(path: Path) -> tuple[str, dict[str, bytes]]:
    """The notebook as Markdown, and its pictures by the names that the Markdown uses."""
    parts, pictures = [], {}
    for cell in json.loads(path.read_text())["cells"]:
        source = "".join(cell["source"])
        if cell["cell_type"] == "markdown":
            parts.append(source)
            continue
        parts.append(f"```python\n{source}\n```")
        for output in cell["outputs"]:
            if output["output_type"] == "stream":
                parts.append(f"```text\n{''.join(output['text']).rstrip()}\n```")
            else:
                name = f"{path.stem}-{len(pictures) + 1}.png"
                pictures[name] = base64.b64decode(output["data"]["image/png"])
                parts.append(f"![what the code above draws]({name})")
    parts.append(f"[This page as a notebook]({path.name}), to download and run.")
    return "\n\n".join(parts) + "\n", pictures
