"""What somebody would lose here: a log in which each line is one that a program wrote, and a terminal as it was."""

from __future__ import annotations

import logging

from lidarcodec.untrusted.text import MOST, PrintableLog, lines_printable, one_line, printable


def test_names_that_are_no_unicode_and_text_that_runs_backwards_are_shown_as_they_are() -> None:
    assert printable("a\udcff\u202eb\u2028c\x9b") == r"a\udcff\u202eb\u2028c\x9b"
    assert lines_printable("one\ntwo\x1b[2J\tthree\n") == "one\ntwo\\x1b[2J\\tthree\n"
    assert printable("Zürich 20 °C 日本") == "Zürich 20 °C 日本"


def test_a_line_that_nobody_could_read_is_cut() -> None:
    """65,000 topics of a bag made an error of half a megabyte."""
    assert one_line("a" * MOST) == "a" * MOST
    assert one_line("\n" + "a" * (MOST + 1233)) == "\\n" + "a" * (MOST - 1) + "... and 1,234 more characters"


def test_a_log_has_a_line_for_each_message_and_a_traceback_its_own() -> None:
    shown = PrintableLog("warning: %(message)s")
    topic = "/a\x1b[2J\nwarning: all is well"
    record = logging.LogRecord("name", logging.WARNING, "path", 1, "topic %s", (topic,), None)
    assert shown.format(record) == r"warning: topic /a\x1b[2J\nwarning: all is well"
    try:
        int("\x1b]0;title\x07")
    except ValueError as error:
        record.msg, record.exc_info = "%r", (ValueError, error, error.__traceback__)
    lines = shown.format(record).splitlines()
    assert lines[1].startswith("Traceback")
    assert all(line.isprintable() for line in lines)
