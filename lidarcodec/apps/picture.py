"""A frame as a picture: its points in perspective, coloured by height, above its range image.

>>> from lidarcodec import read_frames
>>> picture_of(next(read_frames("sim:city?frames=1")), "sim:city").shape
(1220, 1920, 3)
"""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import PIL.Image
import PIL.ImageDraw
import PIL.ImageFont

from lidarcodec.cloud import cloud_to_show
from lidarcodec.files.whole import written_whole
from lidarcodec.frame import Frame
from lidarcodec.sources.unit_calibration import note_of
from lidarcodec.units import AZIMUTH_TURN, LASERS_PER_BLOCK

Image = npt.NDArray[np.uint8]

WIDTH, VIEW_HEIGHT, STRIP_HEIGHT, MARGIN = 1920, 860, 256, 52
FINE = 2
"""Factor by which points are drawn larger and scaled down, for soft edges."""
BACKGROUND = (12, 16, 24)
TEXT = (198, 206, 214)
QUIET = (92, 104, 120)
GROUND = (40, 48, 62)
EYE_M = np.array([-21.0, -11.0, 13.5])
TARGET_M = np.array([9.0, 1.5, -2.0])
FIELD_OF_VIEW_DEG = 58.0
GROUND_Z_M = -1.75
HEIGHTS_M = (-3.6, 4.8)
RANGES_M = (2.0, 90.0)
RINGS_M = (10.0, 20.0, 40.0, 80.0)
HULL_M = (-2.6, 1.6, -0.9, 0.9, 1.5)
"""The car around the sensor: back, front, right, left, and its height."""
_TURBO = np.array([
    [0.13572138, 4.61539260, -42.66032258, 132.13108234, -152.94239396, 59.28637943],
    [0.09140261, 2.19418839, 4.84296658, -14.18503333, 4.27729857, 2.82956604],
    [0.10667330, 12.64194608, -60.58204836, 110.36276771, -89.90310912, 27.34824973],
])  # fmt: skip
"""Google's colour map Turbo in its authors' approximation: red, green and blue as polynomials of the level."""
COLOURS = np.rint(255 * np.clip(np.vander(np.linspace(0.0, 1.0, 256), 6, True) @ _TURBO.T, 0, 1)).astype(np.uint8)
"""(256, 3) colours, from dark blue to dark red."""


def _colours(values: npt.NDArray[Any], low: float, high: float, reverse: bool = False) -> Image:
    """(N, 3) colours of values between low and high."""
    level = np.clip((values - low) / (high - low), 0.0, 1.0)
    colours: Image = COLOURS[np.rint((1.0 - level if reverse else level) * 255).astype(np.uint8)]
    return colours


def _camera() -> npt.NDArray[np.float64]:
    """Rows: right, down and forward of the camera, in the sensor's axes."""
    forward = (TARGET_M - EYE_M) / np.linalg.norm(TARGET_M - EYE_M)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    return np.stack([right, np.cross(forward, right), forward])


def _project(points: npt.NDArray[np.float64], width: int, height: int) -> tuple[npt.NDArray[Any], npt.NDArray[Any]]:
    """Pixel coordinates (N, 2) and depth in metres (N,) of points (N, 3) in the sensor's frame."""
    seen = (points - EYE_M) @ _camera().T
    depth = seen[:, 2]
    focal = width / 2 / np.tan(np.radians(FIELD_OF_VIEW_DEG) / 2)
    safe = np.where(depth > 0.1, depth, np.inf)
    return np.stack([seen[:, 0] / safe * focal + width / 2, seen[:, 1] / safe * focal + height / 2], axis=1), depth


def _polyline(image: PIL.Image.Image, points: npt.NDArray[np.float64], colour: tuple[int, int, int]) -> None:
    """Draw a line through points in metres, without parts behind the camera."""
    pixels, depth = _project(points, *image.size)
    ends, draw = np.rint(pixels).astype(int).tolist(), PIL.ImageDraw.Draw(image)
    for start in np.flatnonzero((depth[:-1] > 1.0) & (depth[1:] > 1.0)):
        draw.line([*ends[start], *ends[start + 1]], colour, FINE + 1)


def _draw_ground(image: PIL.Image.Image) -> None:
    turn = np.linspace(0.0, 2 * np.pi, 181)
    for radius in RINGS_M:
        circle = np.stack([radius * np.cos(turn), radius * np.sin(turn), np.full_like(turn, GROUND_Z_M)], axis=1)
        _polyline(image, circle, GROUND)


def _draw_car(image: PIL.Image.Image) -> None:
    back, front, right, left, height = HULL_M
    top = GROUND_Z_M + height
    for z in (GROUND_Z_M, top):
        corners = [[back, right, z], [front, right, z], [front, left, z], [back, left, z], [back, right, z]]
        _polyline(image, np.array(corners), TEXT)
    for x, y in ((back, right), (front, right), (front, left), (back, left)):
        _polyline(image, np.array([[x, y, GROUND_Z_M], [x, y, top]]), TEXT)


def perspective_of(frame: Frame) -> Image:
    """(860, 1920, 3) RGB: the points seen from behind and above the car, coloured by height."""
    width, height = WIDTH * FINE, VIEW_HEIGHT * FINE
    canvas = PIL.Image.new("RGB", (width, height), BACKGROUND)
    _draw_ground(canvas)
    image: Image = np.array(canvas)
    cloud = cloud_to_show(frame)
    points = np.stack([cloud[axis].astype(np.float64) for axis in "xyz"], axis=1)
    pixels, depth = _project(points, width, height)
    at = np.rint(pixels)
    inside = (depth > 0.5) & (at >= 2).all(axis=1) & (at[:, 0] < width - 3) & (at[:, 1] < height - 3)
    order = np.flatnonzero(inside)[np.argsort(-depth[inside])]
    column, row = at[order].astype(int).T
    # Bright where the surface reflects, dimmer with distance: shapes stand out and the horizon fades.
    brightest = np.iinfo(cloud["intensity"].dtype).max
    light = (0.78 + 0.42 * np.sqrt(cloud["intensity"][order] / brightest)) * np.clip(
        1.2 - depth[order] / 220.0, 0.55, 1.0
    )
    colours = np.minimum(_colours(points[order, 2], *HEIGHTS_M) * light[:, None] + 22.0, 255.0).astype(np.uint8)
    for shift_row in range(-1, 2):
        for shift_column in range(-1, 2):
            near = (abs(shift_row) + abs(shift_column) < 2) | (depth[order] < 30.0)
            image[row[near] + shift_row, column[near] + shift_column] = colours[near]
    canvas = PIL.Image.fromarray(image)
    _draw_car(canvas)
    return np.array(canvas.reduce(FINE))


def range_strip_of(frame: Frame) -> Image:
    """(256, 1920, 3) RGB: rings from the top, forward in the middle, near red and far blue, dark = no return.

    Rows are turned by each laser's rotation correction, so that upright edges stand upright.
    """
    rows, columns = frame.sensor.rows, min(WIDTH, max(1, frame.width))
    strip = np.empty((rows, columns, 3), np.uint8)
    strip[:] = BACKGROUND
    ring, column = np.nonzero(frame.valid)
    laser = frame.sensor.laser_of_ring[ring]
    half = laser // LASERS_PER_BLOCK if frame.sensor.is_hdl64e else 0
    turned = frame.azimuth[half, column] * (360.0 / AZIMUTH_TURN)
    direction_deg = turned - np.degrees(frame.sensor.calibration["rot_correction_rad"])[laser]
    across = np.rint((direction_deg + 180.0) % 360.0 * ((columns - 1) / 360.0)).astype(int)
    metres = np.maximum(frame.range[ring, column] * frame.sensor.range_step_m, RANGES_M[0])
    strip[ring, across] = _colours(np.log(metres), np.log(RANGES_M[0]), np.log(RANGES_M[1]), reverse=True)
    return strip[np.arange(STRIP_HEIGHT)[:, None] * rows // STRIP_HEIGHT, np.arange(WIDTH) * columns // WIDTH]


def picture_of(frame: Frame, title: str) -> Image:
    """(1220, 1920, 3) RGB: perspective above, range image below, each with a line of text."""
    heading = np.full((MARGIN, WIDTH, 3), BACKGROUND, np.uint8)
    picture = PIL.Image.fromarray(np.concatenate([heading, perspective_of(frame), heading, range_strip_of(frame)]))
    draw = PIL.ImageDraw.Draw(picture)

    def write(text: str, x: int, y: int, colour: tuple[int, int, int], size: int) -> None:
        draw.text((x, y), text, colour, PIL.ImageFont.load_default(size), anchor="ls")

    valid = int(np.count_nonzero(frame.valid))
    write(title, 24, 34, TEXT, 22)
    counted = f"{valid:,} points of {frame.sensor.rows} x {frame.width}: range image, forward in the middle"
    if valid and not len(cloud_to_show(frame)):
        counted += f" ({note_of(frame.sensor)})"
    write(counted, 24, MARGIN + VIEW_HEIGHT + 34, QUIET, 19)
    for radius in RINGS_M[:3]:
        pixels, _ = _project(np.array([[0.0, -radius, GROUND_Z_M]]), WIDTH, VIEW_HEIGHT)
        x, y = map(int, np.rint(pixels[0]))
        if 0 <= x < WIDTH - 60 and 20 <= y < VIEW_HEIGHT:
            write(f"{radius:.0f} m", x + 6, MARGIN + y, QUIET, 15)
    return np.array(picture)


def png_of(image: Image) -> bytes:
    """A picture as PNG."""
    out = io.BytesIO()
    PIL.Image.fromarray(image).save(out, "png", compress_level=1)
    return out.getvalue()


def save_picture(image: Image, path: Path) -> None:
    """Write a picture as PNG.

    Raises OSError, SettingsError or SourceError if it cannot be written.
    """
    data = png_of(image)
    path.parent.mkdir(parents=True, exist_ok=True)
    with written_whole(path) as beside:
        beside.write_bytes(data)
