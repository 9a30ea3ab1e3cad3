"""The page in a browser, with a server and a vehicle as processes: what an operator sees."""

from __future__ import annotations

import re

import pytest

from tests.browser.system import system

expect = pytest.importorskip("playwright.sync_api", reason="needs the Python package playwright").expect
expect.set_options(timeout=60_000)


@pytest.fixture(scope="module")
def fleet(tmp_path_factory):
    with system(tmp_path_factory.mktemp("fleet")) as running:
        running.start_vehicle()
        yield running


def test_points_of_the_vehicle_arrive_and_the_title_counts_them(fleet, page_of):
    page = page_of(fleet.url)
    expect(page).to_have_title(re.compile(r"^lidarcodec — [0-9]+ points$"))
    assert int(re.search(r"\d+", page.title())[0]) > 10_000
