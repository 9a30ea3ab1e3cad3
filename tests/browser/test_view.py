"""The live view in a browser: what is drawn is what came, and original against decoded tells the truth."""

from __future__ import annotations

import io
import itertools
import re
import time

import numpy as np
import PIL.Image
import pytest

from lidarcodec.commands.localise.messages import pose_json
from lidarcodec.maps.localise.tracker import Estimate
from lidarcodec.transport import Endpoints, open_transport
from lidarcodec.transport.base import Priority
from lidarcodec.transport.keys import StreamKeys
from tests import asking
from tests.browser.system import LIMIT_S

expect = pytest.importorskip("playwright.sync_api", reason="needs the Python package playwright").expect
expect.set_options(timeout=2000 * LIMIT_S)
pytestmark = pytest.mark.timeout(600)  # a processor draws here what a graphics card does elsewhere

POINTS = re.compile(r"^lidarcodec — [0-9]+ points$")
COLOURS = ("height", "intensity", "distance", "ring")
WINDOW = {"width": 1000, "height": 520}


@pytest.fixture
def page(fleet, page_of):
    shown = page_of(fleet.url, viewport=WINDOW, color_scheme="dark")
    expect(shown).to_have_title(POINTS)
    return shown


def picture(page) -> np.ndarray:
    """(height, width, 3) uint8: the canvas as it is on the screen, without what stands over its upper part."""
    shown = page.locator("canvas.lidar-canvas").screenshot()
    return np.asarray(PIL.Image.open(io.BytesIO(shown)).convert("RGB"))[150:]


def when(ask, holds, what: str):
    """What is asked for, as soon as it is as it should be."""
    end = time.monotonic() + 2 * LIMIT_S
    while not holds(got := ask()):
        assert time.monotonic() < end, f"{what}: {got}"
        time.sleep(0.1)
    return got


def lively(image: np.ndarray) -> float:
    """Part of the picture that has a colour, which ground and background do not have."""
    return float(np.mean(np.ptp(image.astype(int), axis=2) > 40))


def figures(page) -> dict[str, str]:
    texts = page.locator(".lidar-figures > *").all_inner_texts()
    return dict(zip(texts[::2], texts[1::2], strict=True))


def change(fleet, **settings) -> None:
    address = f"{fleet.url}/api/v1/streams/car-7/lidar/settings"
    answer = asking.patch(address, json=settings, timeout=LIMIT_S)
    assert answer.status_code == 200, answer.text


def test_original_against_decoded_shows_no_error_without_loss_and_one_within_the_bound_with_it(fleet, page):
    change(fleet, codec="pcodec", max_error_m=0)
    page.get_by_label("Compare").check()
    expect(page.locator(".lidar-figures")).to_be_visible()
    found = when(lambda: figures(page), lambda shown: shown.get("changed") == "0 %", "lossless")
    assert (found["RMSE"], found["largest"]) == ("0 mm", "0 mm")
    change(fleet, max_error_m=0.05)
    found = when(lambda: figures(page), lambda shown: shown.get("largest") == "50 mm", "within 5 cm")
    assert 10 < float(found["RMSE"].removesuffix(" mm")) < 50
    change(fleet, reduction="columns:4")
    found = when(lambda: figures(page), lambda shown: "not sent" in shown, "reduced")
    assert int(found["not sent"].replace(",", "")) > 50_000
    page.get_by_label("Compare").uncheck()
    expect(page.locator(".lidar-figures")).to_be_hidden()
    change(fleet, reduction="all", max_error_m=0)


@pytest.mark.sweep
def test_gaps_are_filled_fainter_counted_apart_and_only_where_that_is_wanted(fleet, page):
    """Whether the server decodes or the page: a wall is a wall, and nobody takes for measured what was not."""
    change(fleet, codec="predictive", reduction="lattice:16")
    legend = page.locator(".lidar-made")
    expect(legend).to_have_text(re.compile(r"^[\d,]+ measured · [\d,]+ filled in, fainter$"))
    shown: dict[str, tuple[int, ...]] = {}
    for where in ("server", "page"):
        page.get_by_label("Decode here").set_checked(where == "page")
        page.wait_for_timeout(1000)
        shown[where] = when(
            lambda: tuple(map(int, re.findall(r"\d+", legend.inner_text().replace(",", "")))),
            lambda got: len(got) == 2 and 4 * got[0] < got[1] < 15 * got[0],
            where,
        )
        measured = shown[where][0]
        when(
            page.title,
            lambda title, most=2 * measured: int(re.search(r"\d+", title)[0]) < most,
            "the title counts the measured",
        )
        expect(page.locator("footer")).to_contain_text("filled in")
        page.get_by_label("Fill gaps").uncheck()
        expect(legend).to_be_hidden()
        expect(page.locator("footer")).not_to_contain_text("filled in")
        page.get_by_label("Fill gaps").check()
        expect(legend).to_be_visible()
    assert abs(np.log(shown["server"][1] / shown["page"][1])) < 0.1
    page.get_by_label("Decode here").uncheck()
    page.get_by_label("Compare").check()
    expect(page.locator(".lidar-figures")).to_contain_text("not sent")
    expect(legend).to_be_visible()
    assert figures(page)["largest"] == "0 mm", "only what was measured is compared"
    change(fleet, reduction="auto")


@pytest.mark.sweep
def test_where_localise_finds_the_sensor_is_shown_with_its_doubt_and_lost_as_lost(fleet, page):
    line = page.locator(".lidar-where")
    expect(line).to_be_hidden()
    with open_transport(Endpoints(loopback_port=fleet.meeting)) as transport:
        sender = transport.sender(StreamKeys("car-7", "lidar").pose("locator"), Priority.STATUS)

        def said(state: str, shown: str) -> None:
            pose = np.eye(4)
            pose[:2, 3] = 12.5, -3.25
            known = (pose, np.diag([1e-4, 4e-4, 1e-4, 1e-6, 1e-6, 4e-6])) if state == "tracking" else (None, None)

            def say() -> str:
                sender.put(pose_json(Estimate(time.time_ns(), state, *known, 0.5, 0.6), "town", "local"))
                return line.inner_text() if line.is_visible() else ""

            when(say, lambda text: text == shown, state)

        said("tracking", "In map town: x 12.50 m, y -3.25 m, yaw 0.0° ± 2.0 cm, ± 0.11°")
        said("lost", "Lost in map town")
        expect(line).to_have_class(re.compile("lidar-lost"))
    expect(line).to_be_hidden()  # nobody says anything any more


@pytest.mark.sweep
def test_a_point_that_is_clicked_shows_its_fields_and_two_of_them_their_distance(page):
    page.get_by_role("checkbox", name="Measure").check()
    panel = page.locator(".lidar-picked")
    expect(panel).to_contain_text("Click or tap a point")
    box = page.locator("canvas.lidar-canvas").bounding_box()
    for across, down in itertools.product((0.5, 0.4, 0.6, 0.3, 0.7), (0.45, 0.4, 0.5, 0.35)):
        page.mouse.click(box["x"] + across * box["width"], box["y"] + down * box["height"])
        if panel.get_by_text("over the ground").count():
            break
    told = {name: values for name, *values in (row.split("\t") for row in panel.inner_text().splitlines()) if values}
    metres = {
        name: np.array([float(value.removesuffix(" m")) for value in told[name]])
        for name in told
        if " m" in told[name][0]
    }
    (apart,), (flat,), (height,) = metres["distance"], metres["over the ground"], metres["height"]
    points = np.array([metres["x forward"], metres["y left"], metres["z up"]])
    assert abs(apart - np.hypot(flat, height)) < 0.02
    assert np.abs(np.linalg.norm(points, axis=0) - metres["from the sensor"]).max() < 0.02
    if len(set(told["frame"])) == 1:
        assert abs(apart - np.linalg.norm(points[:, 0] - points[:, 1])) < 0.02
    else:
        expect(panel).to_contain_text("Wrong if the vehicle moved")
    page.locator("canvas.lidar-canvas").press("Escape")
    expect(panel).to_contain_text("Click or tap a point")
    page.get_by_role("checkbox", name="Measure").uncheck()
    expect(panel).to_be_hidden()


def test_a_picture_can_be_saved_and_says_what_it_shows(page):
    with page.expect_download(timeout=1000 * LIMIT_S) as saved:
        page.get_by_role("button", name="Save picture").click()
    assert re.fullmatch(r"car-7_lidar_\d+\.png", saved.value.suggested_filename)
    image = np.asarray(PIL.Image.open(saved.value.path()).convert("RGB"))
    box = page.locator("canvas.lidar-canvas").bounding_box()
    assert image.shape[0] > box["height"], "there is a caption below"
    assert lively(image[: int(box["height"])]) > 0.02, "the points are in it"
    assert np.ptp(image[int(box["height"]) :].astype(int)) > 60, "the caption has letters"


@pytest.mark.sweep
def test_the_camera_follows_the_keys_and_the_picture_stays_live(page):
    before = page.title()
    canvas = page.locator("canvas.lidar-canvas")
    canvas.focus()
    for key in ("ArrowLeft", "ArrowUp", "+", "Shift+ArrowRight", "-", "0"):
        canvas.press(key)
    expect(page).not_to_have_title(before)
    assert when(lambda: lively(picture(page)), lambda part: part > 0.02, "points") > 0.02


def test_points_are_really_drawn_and_each_colouring_looks_another_way(fleet, page):
    assert when(lambda: lively(picture(page)), lambda part: part > 0.02, "points") > 0.02
    # a picture that stands still can be compared; and what is old must still be drawn anew when it is asked for
    fleet.kill_vehicle()
    expect(page.locator(".notice")).to_contain_text("last frame")
    shown: dict[str, np.ndarray] = {}
    for colour in COLOURS:
        page.get_by_label("Colour").select_option(colour)
        last = next(reversed(shown.values()), None)
        shown[colour] = when(
            lambda: picture(page),
            lambda image, last=last: last is None or differing(image, last) > 0.05,
            f"{colour} looks as the one before",
        )
        assert lively(shown[colour]) > 0.02
    for one, other in itertools.combinations(COLOURS, 2):
        assert differing(shown[one], shown[other]) > 0.05, (one, other)


def differing(one: np.ndarray, other: np.ndarray) -> float:
    """Part of two pictures that is not alike."""
    return float(np.mean(np.abs(one.astype(int) - other).max(axis=2) > 30))
