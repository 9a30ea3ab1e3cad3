"""One thread for torch: with more, small networks spend their time waiting for each other on a busy machine."""

from __future__ import annotations

import pytest


@pytest.fixture(autouse=True, scope="package")
def one_thread() -> None:
    """Limits torch, where it is installed."""
    torch = pytest.importorskip("torch", reason="training needs torch: the extra `learned`")
    torch.set_num_threads(1)
