"""Digests of arrays in the test vectors."""

from __future__ import annotations

import hashlib
from typing import Any

import numpy as np


def digest(array: np.ndarray[Any, Any]) -> str:
    """The first 16 hex digits of SHA-256 of an array's little-endian bytes."""
    return hashlib.sha256(array.astype(array.dtype.newbyteorder("<")).tobytes()).hexdigest()[:16]
