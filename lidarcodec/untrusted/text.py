"""Text from elsewhere, as a terminal and a log may have it: without characters that steer them or feign other lines.

>>> printable("drive\\t1\\x1b[2J.pcap"), printable("K\u00f6ln 20 \u00b0C")
('drive\\\\t1\\\\x1b[2J.pcap', 'K\u00f6ln 20 \u00b0C')
>>> lines_printable("two\\r\\nlines\\u202e")
'two\\\\r\\nlines\\\\u202e'
"""

from __future__ import annotations

import logging
import re
from typing import Any, Final

_STEERING: Final = re.compile(
    "[\\x00-\\x1f\\x7f-\\x9f\\u061c\\u200e\\u200f\\u2028-\\u202e\\u2066-\\u2069\\ud800-\\udfff]"
)
"""Control characters, ends of lines, changes of the direction of writing, and bytes of names that are no UTF-8."""

MOST: Final = 4_000
"""Characters of a line: a file of 0.3 MB can have names for a line of 0.5 MB."""


def printable(text: str) -> str:
    """The text with escapes for what would steer a terminal, or begin another line."""
    return _STEERING.sub(lambda found: repr(found[0])[1:-1], text)


def one_line(text: str) -> str:
    """The text as a line of an error or a log: printable, and no longer than somebody may read."""
    left_out = len(text) - MOST
    return printable(text[:MOST]) + (f"... and {left_out:,} more characters" if left_out > 0 else "")


def lines_printable(text: str) -> str:
    """The same for a text of several lines, which stay."""
    return "\n".join(map(printable, text.split("\n")))


class PrintableLog(logging.Formatter):
    """Log lines of which only a traceback has more than one line."""

    def formatMessage(self, record: logging.LogRecord) -> str:
        """The line, without a traceback."""
        return one_line(super().formatMessage(record))

    def formatException(self, ei: Any) -> str:
        """A traceback."""
        return lines_printable(super().formatException(ei))
