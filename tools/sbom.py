"""Writes lidarcodec/sbom.cdx.json: what a running installation consists of, as CycloneDX 1.6, from the locks.

    python tools/sbom.py             write it again
    python tools/sbom.py --check     whether it is current

Components: the Python packages of the images (requirements/image-server.txt), and what the built page and the
TypeScript decoder hold of npm (their locks, without what builds and tests them). Tools and the system are not in it.
"""

from __future__ import annotations

import base64
import json
import re
import sys
import tomllib
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
SBOM = ROOT / "lidarcodec" / "sbom.cdx.json"
PIN = re.compile(r"^([A-Za-z0-9._-]+)==([^\s;\\]+)", re.MULTILINE)


def python_components() -> list[dict[str, Any]]:
    """The packages of the server's image. The lock has the hashes: one release has many files."""
    text = (ROOT / "requirements" / "image-server.txt").read_text()
    found = []
    for name, version in PIN.findall(text):
        purl = f"pkg:pypi/{re.sub(r'[-_.]+', '-', name).lower()}@{version}"
        found.append(
            {
                "type": "library",
                "bom-ref": purl,
                "name": name,
                "version": version,
                "purl": purl,
            }
        )
    return found


def npm_components() -> list[dict[str, Any]]:
    """The packages in the built page."""
    found = {}
    for folder in ("web", "typescript"):
        packages = json.loads((ROOT / "clients" / folder / "package-lock.json").read_text())["packages"]
        for path, package in packages.items():
            if not path or package.get("dev") or package.get("link"):
                continue
            name = path.rpartition("node_modules/")[2]
            purl = f"pkg:npm/{name.replace('@', '%40')}@{package['version']}"
            kind, _, digest = package["integrity"].partition("-")
            found[purl] = {
                "type": "library",
                "bom-ref": purl,
                "name": name,
                "version": package["version"],
                "purl": purl,
                "hashes": [{"alg": kind.upper().replace("SHA", "SHA-"), "content": base64.b64decode(digest).hex()}],
                "licenses": [{"expression": package["license"]}] if "license" in package else [],
            }
    return list(found.values())


def bill() -> str:
    """The whole file. It holds no time and no random number: equal locks give equal bytes."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    own = f"pkg:pypi/{project['name']}@{project['version']}"
    components = sorted(python_components() + npm_components(), key=lambda one: str(one["purl"]))
    return (
        json.dumps(
            {
                "bomFormat": "CycloneDX",
                "specVersion": "1.6",
                "version": 1,
                "metadata": {
                    "component": {
                        "type": "application",
                        "bom-ref": own,
                        "name": project["name"],
                        "version": project["version"],
                        "purl": own,
                        "licenses": [{"license": {"id": project["license"]}}],
                    }
                },
                "components": components,
                "dependencies": [{"ref": own, "dependsOn": [one["bom-ref"] for one in components]}],
            },
            indent=1,
        )
        + "\n"
    )


if __name__ == "__main__":
    current = SBOM.is_file() and SBOM.read_text() == bill()
    if "--check" not in sys.argv[1:]:
        SBOM.write_text(bill())
    elif not current:
        print(f"{SBOM} is not current: run `python tools/sbom.py`", file=sys.stderr)
        sys.exit(1)
