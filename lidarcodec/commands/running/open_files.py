"""raise_limit: raises the limit of open files for commands with many connections."""

from __future__ import annotations

import logging
import resource
from typing import Final

logger = logging.getLogger(__name__)

ENOUGH: Final = 65_536
"""Each connection is an open file. More connections would take memory that frames need."""


def raise_limit() -> None:
    """Raise this process's limit of open files as far as the system allows, at most to `ENOUGH`.

    The usual limit is 1,024. Connections of strangers could use all of them, and then no file could be recorded.
    """
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    wanted = ENOUGH if hard == resource.RLIM_INFINITY else min(hard, ENOUGH)
    if soft == resource.RLIM_INFINITY or soft >= wanted:
        return
    try:
        resource.setrlimit(resource.RLIMIT_NOFILE, (wanted, hard))
    except (ValueError, OSError) as error:
        logger.warning("the limit of %d open files cannot be raised: %s", soft, error)
