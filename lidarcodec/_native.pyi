"""Types of the native core; each function's docstring is in native/bindings."""

from typing import Any

def __getattr__(name: str) -> Any: ...
