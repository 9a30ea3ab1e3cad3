"""The page in a browser, with a server and a vehicle as processes: what an operator sees and does."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from tests.browser.system import LIMIT_S
from tests.command_line import ROOT
from tests.sweeps import sampled
from tests.transport.test_contract import eventually

expect = pytest.importorskip("playwright.sync_api", reason="needs the Python package playwright").expect
expect.set_options(timeout=LIMIT_S * 1000)
FRAME = re.compile(r"frame (\d+)")

POINTS = re.compile(r"^lidarcodec — [0-9]+ points$")
AXE = ROOT / "clients" / "web" / "node_modules" / "axe-core" / "axe.min.js"
SETTINGS = "streams/car-7/lidar/settings"


@pytest.fixture
def page(fleet, page_of):
    """The page, with points of the vehicle on it."""
    shown = page_of(fleet.url)
    expect(shown).to_have_title(POINTS)
    return shown


def row_of(page, name="car-7"):
    return page.get_by_role("navigation", name="Streams").get_by_role("button", name=re.compile(name))


def frame_shown(page) -> int:
    """Index of the frame on the screen, a little later."""
    page.wait_for_timeout(100)
    footer = page.locator("footer")
    expect(footer).to_contain_text(FRAME)
    found = FRAME.search(footer.inner_text())
    return int(found[1]) if found else 0  # between two streams it shows none


def outcome(page):
    return page.locator(".outcome")


def test_points_of_the_vehicle_arrive_and_the_title_counts_them(page):
    assert int(re.search(r"\d+", page.title())[0]) > 10_000
    expect(row_of(page)).to_contain_text("kbit/s")
    expect(row_of(page)).to_have_attribute("aria-current", "true")
    expect(page.locator("footer")).to_contain_text("points")


@pytest.mark.sweep
def test_a_generic_calibration_and_streams_without_room_are_reported(fleet, page):
    def with_note(route):
        told = route.fetch().json()
        told["status"]["sensor_model"]["note"] = "generic calibration: clouds can be off"
        route.fulfill(json=told)

    def with_others(route):
        route.fulfill(json=[row | {"left_out": 3} for row in route.fetch().json()])

    page.route("**/api/v1/streams/car-7/lidar", with_note)
    page.route("**/api/v1/fleet*", with_others)
    expect(page.get_by_role("region", name="In force")).to_contain_text("generic calibration: clouds can be off")
    expect(row_of(page)).to_contain_text("3 left out")
    page.unroute_all(behavior="ignoreErrors")
    expect(row_of(page)).not_to_contain_text("left out")


def test_a_codec_is_changed_by_the_form_that_its_schema_makes_and_is_applied(fleet, page):
    page.get_by_label("Codec", exact=True).select_option("zstd")
    page.get_by_label("Level").fill("5")
    page.get_by_role("button", name="Apply").click()
    expect(outcome(page)).to_have_text(re.compile(r"Applied from frame \d+ on \(now shown\): codec = zstd"))
    applied = fleet.get(SETTINGS)["applied"]
    assert (applied["codec"], applied["codec_settings"]) == ("zstd", {"level": 5})
    expect(row_of(page)).to_contain_text("zstd")
    page.get_by_role("tab", name="Changes").click()
    expect(page.get_by_role("listitem").filter(has_text="codec_settings").first).to_contain_text("zstd")
    expect(page).to_have_title(POINTS)


def test_the_page_decodes_what_it_can_and_says_so_where_the_server_must(fleet, page):
    """Networks, weights from the server and the policy of the page among it."""
    sockets = []
    page.on("websocket", lambda socket: sockets.append(socket.url))
    fleet.change(SETTINGS, codec="riddle")
    expect(row_of(page)).to_contain_text("riddle")
    page.get_by_label("Decode here").check()

    assert eventually(lambda: frame_shown(page) and any("/frames?" in url for url in sockets), LIMIT_S)
    before = frame_shown(page)
    assert eventually(lambda: frame_shown(page) > before, 2 * LIMIT_S)
    expect(page).to_have_title(POINTS)
    fleet.change(SETTINGS, codec="pcodec")
    expect(row_of(page)).to_contain_text("pcodec")
    before = frame_shown(page)
    assert eventually(lambda: frame_shown(page) > before, 2 * LIMIT_S)
    expect(page.locator("footer")).not_to_contain_text("The server decodes this stream")
    fleet.change(SETTINGS, codec="jpeg")
    expect(page.locator("footer")).to_contain_text("The server decodes this stream")
    expect(page).to_have_title(POINTS)


@pytest.mark.sweep
def test_the_page_decodes_and_draws_another_sensor_as_the_server_shows_it(fleet, page_of):
    fleet.start_vehicle("car-8", "sim:city?sensor=vlp16")
    try:
        page = page_of(f"{fleet.url}/#car-8/lidar")
        sockets = []
        page.on("websocket", lambda socket: sockets.append(socket.url))
        row_of(page, "car-8").click()
        expect(page).to_have_title(POINTS)
        page.get_by_label("Decode here").check()
        assert eventually(
            lambda: page.wait_for_timeout(100) or any("car-8/lidar/frames?" in url for url in sockets), LIMIT_S
        )
        before = frame_shown(page)
        assert eventually(lambda: frame_shown(page) > before, 2 * LIMIT_S)
        expect(page).to_have_title(POINTS)
        expect(page.locator("footer")).not_to_contain_text("The server decodes this stream")
    finally:
        fleet.kill_vehicle("car-8")


@pytest.mark.sweep
def test_a_target_that_pinned_settings_keep_out_of_reach_is_reported_in_red_over_the_picture(fleet, page):
    """A viewer who did not set anything has to see it, too: two frames a second look like a bad line."""
    banner = page.get_by_role("region", name="Target bitrate")
    expect(banner).not_to_be_attached()
    pinned = {"max_error_m": 0, "intensity": "lossless", "reduction": "all"}
    fleet.change(SETTINGS, codec="pcodec", target_kbps=300, **pinned)
    alarm = banner.get_by_role("alert")
    expect(alarm).to_contain_text("Max error (m), Intensity and Reduction are in the way")
    # As expected of the settings, or as measured, whichever the page was told by now.
    expect(banner).to_contain_text(re.compile(r"300 kbit/s .* with max_error_m, intensity and reduction as set"))
    expect(alarm).to_have_text(re.compile("Target missed|Frames are left out"))  # now it was measured
    expect(banner).to_contain_text(re.compile(r"Set max_error_m, intensity and reduction back, .* or set a target of"))
    stage, red = page.locator(".stage").bounding_box(), banner.bounding_box()
    assert red["y"] < stage["y"] + stage["height"] / 4
    assert red["width"] == stage["width"]
    assert banner.evaluate("one => getComputedStyle(one).backgroundColor") == "rgb(179, 38, 30)"
    page.get_by_role("button", name="Set back").click()
    expect(banner).not_to_be_attached()
    applied = fleet.get(SETTINGS)["applied"]
    free = {"max_error_m": None, "intensity": "auto", "reduction": "auto", "target_kbps": 300.0}
    assert {name: applied[name] for name in free} == free
    fleet.change(SETTINGS, target_kbps=None)


@pytest.mark.sweep
def test_a_link_is_chosen_by_name_and_says_that_it_is_nothing_but_three_settings(fleet, page):
    fleet.change(SETTINGS, codec="pcodec", intensity="lossless")
    form = page.get_by_role("form", name=re.compile("^Settings of"))
    field = form.locator(".field").filter(has=page.locator("#setting-intensity"))
    expect(field.locator(".chip")).to_have_text("pinned")
    before = fleet.get(SETTINGS)["applied"]
    preset = next(one for one in fleet.get("links") if one["name"] == "2mbit")
    page.get_by_role("button", name=preset["label"]).click()
    expect(page.get_by_role("button", name=preset["label"])).to_have_attribute("aria-pressed", "true")
    expect(page.get_by_role("group", name="Link")).to_contain_text(
        f"Sets only purpose = look, codec = auto, target_kbps = {preset['settings']['target_kbps']:.0f}. "
        "Unchanged: Intensity."
    )
    page.get_by_role("button", name="Do not set Intensity").click()
    expect(field.locator(".chip")).to_have_text("not set")
    page.get_by_role("button", name="Apply").click()
    expect(outcome(page)).to_contain_text("Applied from frame")
    assert fleet.get(SETTINGS)["applied"] == before | preset["settings"] | {"intensity": "auto"}
    expect(page.get_by_role("region", name="In force")).to_contain_text(re.compile(r"In force \w+ \(auto\)"))
    fleet.change(SETTINGS, codec="pcodec", target_kbps=None)


def test_what_the_server_refuses_is_reported_where_it_was_written(fleet, page):
    before = fleet.get(SETTINGS)["applied"]
    page.get_by_label("Target (kbit/s)").fill("0.5")
    page.get_by_role("button", name="Apply").click()
    expect(page.get_by_label("Target (kbit/s)")).to_be_focused()
    expect(page.get_by_label("Target (kbit/s)")).to_have_attribute("aria-invalid", "true")
    expect(page.locator("#setting-target_kbps-problem")).to_contain_text("1 to 1000000 kbit/s")
    assert fleet.get(SETTINGS)["applied"] == before
    page.complaints[:] = [text for text in page.complaints if "422" not in text]  # the browser tells of every refusal


def test_the_form_is_filled_and_sent_with_the_keyboard_alone(fleet, page):
    fleet.change(SETTINGS, codec="pcodec")
    page.reload()
    expect(page).to_have_title(POINTS)
    expect(page.get_by_label("Codec", exact=True)).to_have_value("pcodec")
    page.keyboard.press("Tab")
    expect(page.get_by_role("button", name="Skip to settings")).to_be_focused()
    page.keyboard.press("Enter")
    for _ in range(30):
        page.keyboard.press("Tab")
        if page.evaluate("document.activeElement.id") == "setting-max_error_m":
            break
    else:
        pytest.fail("the bound is not reached")
    page.keyboard.type("0.02")
    page.keyboard.press("Enter")
    expect(outcome(page)).to_contain_text("Applied from frame")
    assert fleet.get(SETTINGS)["applied"]["max_error_m"] == 0.02
    page.get_by_role("tab", name="Settings").focus()
    page.keyboard.press("ArrowRight")
    expect(page.get_by_role("tab", name="Changes")).to_be_focused()
    expect(page.get_by_role("tabpanel", name="Changes")).to_be_visible()


def test_everything_that_can_be_done_has_a_name_and_is_reached_by_the_tabulator(page):
    unnamed = page.evaluate(
        """() => [...document.querySelectorAll('button, input, select, a[href], summary')].filter((one) => {
             const named = one.getAttribute('aria-label') || one.labels?.length || one.textContent.trim();
             return !named || (one.tabIndex < 0 && one.getAttribute('role') !== 'tab');
           }).map((one) => one.outerHTML.slice(0, 120))"""
    )
    assert unnamed == []


@pytest.mark.parametrize(
    ("panel", "scheme"),
    sampled([("Settings", "light"), ("Settings", "dark"), ("Recordings", "light")], [("Settings", "light")]),
)
def test_people_with_other_senses_and_hands_find_no_serious_hindrance(fleet, page_of, panel, scheme):
    """By the rules of axe (WCAG 2.2, levels A and AA)."""
    if not AXE.exists():
        pytest.skip("needs axe-core: npm install in clients/web")
    page = page_of(fleet.url, color_scheme=scheme)
    expect(page).to_have_title(POINTS)
    page.get_by_role("tab", name=panel).click()
    expect(page.get_by_role("tabpanel", name=panel)).to_be_visible()
    page.get_by_role("checkbox", name="Measure").check()
    page.evaluate(AXE.read_text())
    found = page.evaluate("async () => (await axe.run()).violations")
    page.get_by_role("checkbox", name="Measure").uncheck()
    assert page.evaluate("async () => (await axe.run()).passes.length") > 20
    told = [(one["id"], one["impact"], [node["html"][:120] for node in one["nodes"]]) for one in found]
    assert [one for one in told if one[1] in ("serious", "critical")] == []


@pytest.mark.sweep
def test_a_key_frame_is_asked_for(page):
    page.get_by_role("button", name="Key frame").click()
    expect(outcome(page)).to_have_text(re.compile(r"A key frame will be sent: frame \d+"))


def test_a_stream_is_recorded_and_played_back_with_a_time_line(fleet, page):
    page.get_by_role("tab", name="Recordings").click()
    page.get_by_role("button", name="Record car-7/lidar").click()
    expect(row_of(page)).to_contain_text("REC")
    assert eventually(lambda: (fleet.get("streams/car-7/lidar/recording")["frames"] or 0) > 6, LIMIT_S)
    page.get_by_role("button", name="Stop recording").click()
    page.get_by_role("button", name=re.compile("^Play car-7")).click()
    place = page.get_by_role("slider", name="Position in the recording")
    expect(place).to_be_visible()
    expect(page.locator("footer")).to_contain_text("playback-")
    page.get_by_role("button", name="Pause").click()
    expect(page.get_by_role("button", name="Play", exact=True)).to_have_attribute("aria-pressed", "true")
    (made,) = fleet.get("recordings")

    def place_in(low: float, high: float) -> bool:
        playing = fleet.get(f"recordings/{made['id']}")["playing"]
        return low <= playing["position_s"] / playing["duration_s"] <= high

    place.focus()
    page.keyboard.press("End")
    assert eventually(lambda: place_in(0.6, 1.0), LIMIT_S)
    page.keyboard.press("Home")
    assert eventually(lambda: place_in(0.0, 0.5), LIMIT_S)
    expect(page).to_have_title(POINTS)
    page.get_by_role("group", name="Playback").get_by_role("button", name="Stop").click()
    expect(place).not_to_be_attached()
    with page.expect_download(timeout=1000 * LIMIT_S) as fetched:
        page.get_by_role("button", name=re.compile("^Download car-7")).click()
    assert fetched.value.suggested_filename == f"car-7_lidar_{made['id']}.mcap"
    (kept,) = (fleet.folder / "recordings" / made["id"]).glob("*.mcap")
    assert Path(fetched.value.path()).read_bytes() == kept.read_bytes()
    delete = page.get_by_role("button", name=re.compile("^Delete car-7"))
    expect(delete).to_be_enabled()
    delete.click()
    page.get_by_role("button", name="Delete", exact=True).click()
    expect(page.get_by_text("There are no recordings yet.")).to_be_visible()
    ended = re.compile("streams/playback-.* 404|status of 404")  # the browser tells of asking for what has just ended
    page.complaints[:] = [text for text in page.complaints if not ended.search(text)]


def test_a_narrow_screen_shows_everything_without_scrolling_sideways(fleet, page_of):
    page = page_of(fleet.url, viewport={"width": 360, "height": 740})
    expect(page).to_have_title(POINTS)
    expect(page.get_by_label("Codec", exact=True)).to_be_attached()
    assert page.evaluate("document.documentElement.scrollWidth") <= 360
    page.get_by_role("button", name="Key frame").scroll_into_view_if_needed()
    expect(page.get_by_role("button", name="Key frame")).to_be_in_viewport()


def test_a_stream_that_nobody_ever_saw_is_no_lost_connection(fleet, page_of):
    page = page_of(f"{fleet.url}/#/car-8/roof")
    expect(page.locator(".notice")).to_contain_text("The server does not know car-8/roof. It appears")
    expect(page.get_by_text("The server does not know car-8/roof.", exact=True)).to_be_visible()
    row_of(page).click()
    expect(page).to_have_title(POINTS)
    page.complaints.clear()  # the browser tells of every 404


def test_a_vehicle_that_goes_is_seen_to_go_and_seen_again_when_it_is_back(fleet, page):
    fleet.kill_vehicle()
    expect(page.locator(".notice")).to_contain_text(re.compile(r"last frame \d+ s ago"))
    expect(row_of(page)).to_contain_text("away")
    page.get_by_label("Intensity", exact=True).select_option("off")
    page.get_by_role("button", name="Apply").click()
    expect(outcome(page)).to_contain_text("Stored: intensity = off")
    fleet.start_vehicle()
    expect(page.locator(".notice.none")).to_be_attached()
    expect(row_of(page)).to_contain_text("kbit/s")
    expect(page.get_by_role("region", name="In force")).to_contain_text("In force")
    assert eventually(lambda: (fleet.get(SETTINGS)["applied"] or {}).get("intensity") == "off", LIMIT_S)
    expect(page).to_have_title(POINTS)
