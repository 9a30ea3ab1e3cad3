"""Several streams in one picture, the box, saved views and clips: what is shown says what it is."""

from __future__ import annotations

import json
import re

import pytest

from tests.browser.system import LIMIT_S
from tests.browser.test_page import AXE
from tests.browser.test_view import lively, picture, when
from tests.transport.test_contract import eventually

expect = pytest.importorskip("playwright.sync_api", reason="needs the Python package playwright").expect
expect.set_options(timeout=2000 * LIMIT_S)
pytestmark = pytest.mark.timeout(600)  # a processor draws here what a graphics card does elsewhere

SWEEP = pytest.mark.sweep
POINTS = re.compile(r"^lidarcodec — [0-9]+ points$")
WINDOW = {"width": 1280, "height": 800}
NARROW = {"width": 390, "height": 844}
SENSORS = """\
  - {name: front, source: "sim:street?sensor=vlp16", mount: [3.8, 0, 0.6, 0, 0, 0], rate: 2}
  - {name: left, source: "sim:street?sensor=vlp16", mount: [2.0, 0.9, 0.8, 0, 0, 90], rate: 2}
  - {name: rear, source: "sim:street?sensor=vlp16", rate: 2}
"""


@pytest.fixture(scope="module")
def car(running):
    """A server and a vehicle with three sensors, which is gone for the tests behind these: car-7 is the first alive."""
    running.start_vehicle()
    running.start_sensors("car-9", SENSORS)
    sensors = 1 + SENSORS.count("name:")
    assert eventually(lambda: sum(one["alive"] for one in running.get("streams")) >= sensors, LIMIT_S)
    yield running
    running.end_vehicle("car-9")


@pytest.fixture
def shown(car, page_of):
    """The page with the front sensor of the vehicle."""
    page = page_of(f"{car.url}/#/car-9/front", viewport=WINDOW, color_scheme="dark")
    expect(page).to_have_title(POINTS)
    return page


def unfold(page, name: str) -> None:
    if page.locator("details[open]", has_text=name).count() == 0:
        page.locator("summary", has_text=name).click()


def show_beside(page, *names: str) -> None:
    unfold(page, "Streams")
    for name in names:
        page.get_by_label(f"car-9/{name}").check()


def legend(page) -> str:
    return page.locator(".lidar-streams").inner_text()


def stands(page) -> list[float]:
    """Where the camera stands: what a view that is saved now has of it."""
    unfold(page, "Views")
    page.get_by_label("Name of the view").fill("now")
    page.get_by_role("button", name="Save view").click()
    kept = json.loads(page.evaluate("localStorage.getItem('lidarcodec.views')"))
    stand = kept[0]["stand"]
    return [stand[name] for name in ("yaw", "pitch", "distance", "x", "y")]


def in_box(page) -> tuple[int, int]:
    found = re.search(r"([\d,]+) of ([\d,]+) in the box", page.locator("footer").inner_text())
    return (0, 0) if found is None else tuple(int(one.replace(",", "")) for one in found.groups())


def test_streams_of_a_vehicle_are_one_picture_and_say_how_they_were_placed(shown):
    expect(shown.locator(".lidar-streams")).to_be_hidden()
    alone = lively(picture(shown))
    show_beside(shown, "left", "rear")
    told = when(lambda: legend(shown), lambda text: len(re.findall(r"[1-9][\d,]{3,}", text)) == 3, "three with points")
    assert [one in told for one in ("car-9/front", "car-9/left", "car-9/rear")] == [True] * 3
    assert told.count("no mounting: drawn at the vehicle's origin") == 1
    when(lambda: lively(picture(shown)), lambda now: now > 1.3 * alone, "more points are drawn")
    shown.get_by_label("car-9/rear").uncheck()
    when(lambda: legend(shown), lambda text: "rear" not in text, "two are left")


@SWEEP
def test_each_stream_has_its_colour_or_all_share_one(shown):
    show_beside(shown, "left")
    expect(shown.locator(".lidar-swatch").first).to_be_hidden()
    shown.get_by_label("Colour").select_option("stream")
    expect(shown.locator(".lidar-swatch").first).to_be_visible()
    colours = shown.evaluate(
        "() => [...document.querySelectorAll('.lidar-swatch')].map((one) => getComputedStyle(one).backgroundColor)"
    )
    assert len(set(colours)) == 2
    expect(shown.locator(".lidar-scale").first).to_be_hidden()
    orange = (229, 158, 0)

    def part(image) -> float:
        """Of points in the second stream's colour, light or dark by their height."""
        hue = image.astype(float) / max(image.max(), 1)
        near = (hue[..., 0] > 0.45) & (abs(hue[..., 1] / (hue[..., 0] + 1e-6) - orange[1] / orange[0]) < 0.12)
        return float((near & (hue[..., 2] < 0.12)).mean())

    when(lambda: part(picture(shown)), lambda now: now > 0.002, "the other stream is orange")


@pytest.mark.sweep
def test_points_outside_the_box_are_not_drawn_and_the_count_says_so(shown):
    show_beside(shown, "left")
    whole = when(lambda: lively(picture(shown)), lambda now: now > 0.01, "points")
    unfold(shown, "Box")
    shown.get_by_label("Draw only what is in the box").check()
    for axis in ("forward", "left"):
        shown.get_by_label(f"{axis}, from").fill("-3")
        shown.get_by_label(f"{axis}, to").fill("3")
    inside, points = when(lambda: in_box(shown), lambda both: both[1] > 0 and both[0] < 0.2 * both[1], "few are left")
    assert points > 20_000, "of both streams"
    when(lambda: lively(picture(shown)[: -shown.viewport_size["height"] // 4]), lambda now: now < whole / 2, "drawn")
    shown.get_by_label("Draw only what is in the box").uncheck()
    expect(shown.locator("footer")).not_to_contain_text("in the box")
    assert inside < points


@SWEEP
def test_a_view_is_kept_by_name_and_shown_again_also_after_a_reload(shown):
    show_beside(shown, "left")
    shown.locator("canvas.lidar-canvas").focus()
    for _ in range(3):
        shown.keyboard.press("ArrowLeft", delay=120)
    unfold(shown, "Box")
    shown.get_by_label("Draw only what is in the box").check()
    shown.get_by_label("up, to").fill("2")
    before = stands(shown)
    unfold(shown, "Views")
    shown.get_by_label("Name of the view").fill("Kerb")
    shown.get_by_label("Name of the view").press("Enter")
    shown.reload()
    expect(shown).to_have_title(POINTS)
    unfold(shown, "Views")
    shown.get_by_role("button", name="Kerb", exact=True).click()
    when(lambda: legend(shown), lambda text: "car-9/left" in text, "the other stream is back")
    when(lambda: in_box(shown), lambda both: both[1] > 0, "so is the box")
    assert stands(shown) == pytest.approx(before)
    unfold(shown, "Views")
    shown.get_by_role("button", name="Delete Kerb").click()
    expect(shown.get_by_role("button", name="Kerb", exact=True)).to_have_count(0)


@pytest.mark.sweep
def test_a_view_that_was_sent_is_shown_where_its_link_is_opened_and_a_broken_one_is_none(shown, car):
    show_beside(shown, "left")
    unfold(shown, "Views")
    shown.get_by_label("Name of the view").fill("Für dich")
    shown.get_by_role("button", name="Save view").click()
    shown.get_by_role("button", name="Share Für dich").click()
    link = shown.get_by_label("Link to Für dich").input_value()
    assert link.startswith(f"{car.url}/#/car-9/front?view=")
    shown.evaluate("localStorage.clear()")
    shown.goto("about:blank")
    shown.goto(link)
    when(lambda: legend(shown), lambda text: "car-9/left" in text, "both streams")
    shown.goto("about:blank")
    shown.goto(f"{link[:-40]}AAAA")
    expect(shown).to_have_title(POINTS)
    expect(shown.locator(".lidar-streams")).to_be_hidden()


@pytest.mark.sweep
def test_a_clip_is_a_film_of_the_picture(shown, tmp_path):
    with shown.expect_download() as download:
        shown.get_by_role("button", name="Record clip").click()
        expect(shown.get_by_role("button", name=re.compile(r"Save clip \([2-9] s\)"))).to_be_visible()
        shown.get_by_role("button", name="Save clip").click()
    assert re.fullmatch(r"car-9_front_\d+\.webm", download.value.suggested_filename)
    download.value.save_as(tmp_path / "clip.webm")
    assert (tmp_path / "clip.webm").read_bytes()[:4] == b"\x1a\x45\xdf\xa3"
    expect(shown.get_by_role("button", name="Record clip")).to_be_visible()
    av = pytest.importorskip("av", reason="reads the film (extra `video`)")
    with av.open(str(tmp_path / "clip.webm")) as film:
        frames = [frame.to_ndarray(format="rgb24") for frame in film.decode(video=0)]
    canvas = shown.locator("canvas.lidar-canvas").bounding_box()
    assert len(frames) >= 2
    assert frames[0].shape[0] > canvas["height"] + 10, "with a caption below"
    assert lively(frames[-1][150:]) > 0.005


@SWEEP
def test_fingers_turn_and_pinch(shown):
    def fingers(*ways: tuple[tuple[int, int], tuple[int, int]]) -> None:
        """Put fingers down, move each from one place to another, and lift them."""
        shown.evaluate(
            """(ways) => {
                 const canvas = document.querySelector('canvas.lidar-canvas');
                 const { left, top } = canvas.getBoundingClientRect();
                 canvas.setPointerCapture = () => {};
                 const tell = (name, pointerId, [x, y]) => canvas.dispatchEvent(new PointerEvent(name, {
                   pointerId, pointerType: 'touch', clientX: left + x, clientY: top + y, bubbles: true, buttons: 1 }));
                 ways.forEach(([from], id) => tell('pointerdown', id + 1, from));
                 for (let step = 1; step <= 8; step++)
                   ways.forEach(([[x, y], [u, v]], id) =>
                     tell('pointermove', id + 1, [x + (u - x) * step / 8, y + (v - y) * step / 8]));
                 ways.forEach(([, to], id) => tell('pointerup', id + 1, to));
               }""",
            [list(map(list, way)) for way in ways],
        )

    shown.set_viewport_size(NARROW)
    yaw, _, distance, x, y = stands(shown)
    fingers(((100, 150), (180, 150)))
    turned = stands(shown)
    assert turned[0] != pytest.approx(yaw, abs=0.1), "one finger turns"
    assert turned[2:] == pytest.approx([distance, x, y])
    fingers(((150, 150), (100, 150)), ((200, 150), (250, 150)))
    pinched = stands(shown)
    assert pinched[2] == pytest.approx(distance / 3, rel=0.05), "two that part come nearer"
    assert pinched[0] == pytest.approx(turned[0])
    fingers(((150, 150), (150, 200)), ((200, 150), (200, 200)))
    panned = stands(shown)
    assert panned[2] == pytest.approx(pinched[2], rel=0.05)
    assert abs(panned[3] - pinched[3]) + abs(panned[4] - pinched[4]) > 0.5, "two in one direction move"


@pytest.mark.sweep
@pytest.mark.parametrize("scheme", ["light", pytest.param("dark", marks=SWEEP)])
def test_people_with_other_senses_and_hands_find_no_serious_hindrance_in_the_scene(car, page_of, scheme):
    """By the rules of axe (WCAG 2.2, levels A and AA)."""
    if not AXE.exists():
        pytest.skip("needs axe-core: npm install in clients/web")
    page = page_of(f"{car.url}/#/car-9/front", color_scheme=scheme)
    expect(page).to_have_title(POINTS)
    show_beside(page, "left", "rear")
    page.get_by_label("Colour").select_option("stream")
    unfold(page, "Box")
    page.get_by_label("Draw only what is in the box").check()
    stands(page)
    page.get_by_role("button", name="Share now").click()
    page.evaluate(AXE.read_text())
    for name in ("Streams", "Box", "Views"):
        unfold(page, name)
        found = page.evaluate("async () => (await axe.run()).violations")
        told = [(one["id"], one["impact"], [node["html"][:120] for node in one["nodes"]]) for one in found]
        assert [one for one in told if one[1] in ("serious", "critical")] == [], name


@SWEEP
def test_a_narrow_screen_shows_the_scene_without_scrolling_sideways(car, page_of):
    page = page_of(f"{car.url}/#/car-9/front", viewport=NARROW)
    expect(page).to_have_title(POINTS)
    show_beside(page, "left", "rear")
    for name in ("Streams", "Box", "Views"):
        unfold(page, name)
        assert page.evaluate("document.documentElement.scrollWidth") <= NARROW["width"], name
    box = page.locator(".lidar-streams").bounding_box()
    assert box["x"] >= 0
    assert box["x"] + box["width"] <= NARROW["width"]
