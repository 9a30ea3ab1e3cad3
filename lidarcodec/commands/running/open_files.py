"""raise_limit: commands that hold connections may open as many files as the system lets them."""

from __future__ import annotations

import logging
import resource
from typing import Final

logger = logging.getLogger(__name__)

ENOUGH: Final = 65_536
"""Each connection is a file. More of them would take memory that the frames need."""


def raise_limit() -> None:
    """Raise this process's limit of open files to what is allowed, at most `ENOUGH`.

    The usual 1,024 are soon taken by connections of strangers, and nothing can be recorded then.
    """
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    wanted = ENOUGH if hard == resource.RLIM_INFINITY else min(hard, ENOUGH)
    if soft == resource.RLIM_INFINITY or soft >= wanted:
        return
    try:
        resource.setrlimit(resource.RLIMIT_NOFILE, (wanted, hard))
    except (ValueError, OSError) as error:
        logger.warning("the limit of %d open files cannot be raised: %s", soft, error)
