"""The archive in the page: searched, played and downloaded."""

from __future__ import annotations

import re

import pytest

from tests.browser.system import LIMIT_S, system
from tests.browser.test_page import AXE
from tests.command_line import run_here
from tests.drives import simulated

pytest.importorskip("duckdb", reason="needs the extra archive")
expect = pytest.importorskip("playwright.sync_api", reason="needs the Python package playwright").expect
expect.set_options(timeout=LIMIT_S * 1000)

pytestmark = pytest.mark.sweep


@pytest.fixture(scope="module")
def archived(browser, tmp_path_factory):
    """A server with an archive of two segments of car-7/roof."""
    folder = tmp_path_factory.mktemp("archived")
    (folder / "in" / "car-7" / "roof").mkdir(parents=True)
    drive = folder / "in" / "car-7" / "roof" / "drive.pcap"
    simulated("sim:city?sensor=vlp16&frames=13", drive)
    done = run_here("archive", "run", str(folder / "in"), str(folder / "out"), "--workers", "here", "--seconds", "1")
    assert done.returncode == 0, done.stderr
    with system(folder, archive=folder / "out") as made:
        yield made


def test_a_segment_is_found_played_and_downloaded(archived, page_of, tmp_path):
    page = page_of(archived.url)
    page.get_by_role("tab", name="Recordings").click()
    archive = page.get_by_role("region", name="Archive")
    items = archive.get_by_role("listitem")
    expect(items).to_have_count(2)
    expect(items.first).to_contain_text("car-7/roof")
    expect(items.first).to_contain_text("pcodec, lossless")
    if AXE.exists():
        page.evaluate(AXE.read_text())
        found = page.evaluate("async () => (await axe.run()).violations")
        assert [one["id"] for one in found if one["impact"] in ("serious", "critical")] == []

    archive.get_by_label("Vehicle").fill("car-8")
    archive.get_by_role("button", name="Search").click()
    expect(archive).to_contain_text("No segment fits this search")
    archive.get_by_label("Vehicle").fill("")
    archive.get_by_label("Place X").fill("1")
    archive.get_by_role("button", name="Search").click()
    expect(archive.get_by_role("alert")).to_have_text("A place needs X and Y.")
    archive.get_by_label("Place X").fill("")
    archive.get_by_role("button", name="Search").click()
    expect(items).to_have_count(2)

    with page.expect_download() as begun:
        items.first.get_by_role("button", name="Download").click()
    begun.value.save_as(tmp_path / "got.mcap")
    assert (tmp_path / "got.mcap").read_bytes() in [path.read_bytes() for path in archived.folder.rglob("*.mcap")]

    items.first.get_by_role("button", name="Play").click()
    expect(items.first.get_by_role("button", name="Stop playing")).to_be_visible()
    expect(page).to_have_title(re.compile(r"^lidarcodec — [0-9]+ points$"))
    expect(page.get_by_role("slider", name="Position in the recording")).to_be_visible()
    items.first.get_by_role("button", name="Stop playing").click()
    expect(items.first.get_by_role("button", name="Play")).to_be_visible()
    ended = re.compile("streams/playback-.* 404|status of 404")  # the browser tells of asking for what has just ended
    page.complaints[:] = [text for text in page.complaints if not ended.search(text)]
