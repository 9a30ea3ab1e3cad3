"""Tables of results, as they are read on a terminal."""

from lidarcodec.evaluation.bench import effective
from lidarcodec.evaluation.report import aligned, label
from lidarcodec.settings import StreamSettings


def test_a_table_that_is_wider_than_the_terminal_goes_on_below():
    rows = [["setting", "kbit/s", "points", "found %"], ["pcodec target_kbps=500", "498", "30,000", "91.2"]]
    assert len(aligned(rows)) == 2
    lines = aligned(rows, 40)
    assert max(map(len, lines)) <= 40
    assert [line.split()[-1] for line in lines if line] == ["points", "30,000", "%", "91.2"]
    assert aligned(rows, 3)[1].split() == ["pcodec", "target_kbps=500", "498"]  # at least one column beside the first


def test_settings_are_told_as_they_are_typed():
    settings = effective(StreamSettings(codec="pcodec", target_kbps=500, max_error_m=0.01))
    assert label({"codec": "pcodec", "settings": settings}) == "pcodec max_error_m=0.01 target_kbps=500"
