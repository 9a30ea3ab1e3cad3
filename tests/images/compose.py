"""The compose files as values, put together as `docker compose` puts them together."""

from __future__ import annotations

from typing import Any

import yaml

from tests.images.dockerfile import ROOT

FOLDER = ROOT / "docker"


class _Reset:
    """`!reset`: what stood there is taken away."""


class _Loader(yaml.SafeLoader):
    pass


_Loader.add_constructor("!reset", lambda _loader, _node: _Reset())


def read(*names: str) -> dict[str, Any]:
    """compose.yaml, and others over it."""
    whole: Any = {}
    for name in names:
        whole = _over(whole, yaml.load((FOLDER / name).read_text(), _Loader))
    return whole


def _over(below: Any, above: Any) -> Any:
    if isinstance(below, dict) and isinstance(above, dict):
        both = {key: _over(below[key], above[key]) if key in below else above[key] for key in above}
        return {key: value for key, value in (below | both).items() if not isinstance(value, _Reset)}
    return above


def service_networks(service: dict[str, Any]) -> set[str]:
    """The names of its networks; they are a list or a mapping."""
    return set(service["networks"])
