"""The past of a vehicle on the page: fetched exactly, cancelled, and there again after a reload."""

from __future__ import annotations

import re

import pytest

from tests.browser.system import LIMIT_S
from tests.browser.test_page import AXE
from tests.packets import packets_in

expect = pytest.importorskip("playwright.sync_api", reason="needs the Python package playwright").expect

CAR = "car-9"
KEPT = re.compile(r"^\d+ (s|min).*, ")


@pytest.fixture
def keeping(fleet):
    """The fleet, with a vehicle that keeps what it sees."""
    fleet.start_vehicle(CAR, keep=True)
    yield fleet
    if CAR in fleet._vehicles:
        fleet.kill_vehicle(CAR)


def past_of(page):
    return page.get_by_role("region", name="Past")


@pytest.mark.sweep
def test_the_last_seconds_are_fetched_played_and_saved_and_a_fetch_without_the_vehicle_can_be_cancelled(
    keeping, page_of
):
    page = page_of(f"{keeping.url}/#/{CAR}/lidar")
    past = past_of(page)
    vehicle = past.get_by_role("definition").first
    expect(vehicle).to_have_text(KEPT)
    button = past.get_by_role("button", name="Fetch the last 30 s exactly")
    button.focus()
    page.keyboard.press("Enter")
    expect(past.get_by_text("Here, exactly:")).to_be_visible()
    expect(past.get_by_role("definition").nth(1)).to_have_text(KEPT)
    page.evaluate(AXE.read_text())
    found = page.evaluate("async () => (await axe.run('.past')).violations")
    assert [(one["id"], one["impact"]) for one in found if one["impact"] in ("serious", "critical")] == []

    with page.expect_download(timeout=1000 * LIMIT_S) as saved:
        past.get_by_role("button", name=re.compile("^Download ")).click()
    assert len(packets_in(saved.value.path())) > 348
    past.get_by_role("button", name=re.compile("^Play ")).click()
    place = page.get_by_role("slider", name="Position in the recording")
    expect(place).to_be_visible()
    page.get_by_role("group", name="Playback").get_by_role("button", name="Stop").click()
    expect(place).not_to_be_attached()

    page.get_by_role("navigation", name="Streams").get_by_role("button", name=re.compile(CAR)).click()
    expect(vehicle).to_have_text(KEPT)
    page.wait_for_timeout(1000)  # it keeps more than the first clip has
    keeping.kill_vehicle(CAR)
    button.click()
    expect(past.get_by_text("Waiting for the vehicle to answer")).to_be_visible()
    page.reload()
    expect(past.get_by_text("Waiting for the vehicle to answer")).to_be_visible()
    cancel = past.get_by_role("button", name=re.compile("^Cancel "))
    cancel.click()
    expect(cancel).not_to_be_attached()
    expect(past.get_by_text("Here, exactly:")).to_be_visible()
    page.complaints[:] = [
        text for text in page.complaints if "404" not in text
    ]  # of what is not there yet, or not any more
