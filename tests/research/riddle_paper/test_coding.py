"""If these fail, the paper's predictor cannot be decoded from its own bytes, or says more than a decoder could know."""

from __future__ import annotations

import numpy as np
import pytest

from lidarcodec.errors import DecodeError, UnknownNameError

torch = pytest.importorskip("torch", reason="training needs torch: the extra `learned`")

from lidarcodec.motion.motion import Motion  # noqa: E402
from lidarcodec.training import runs  # noqa: E402
from research.riddle_paper.coding import CODERS, Predictor, decode_image, encode_image  # noqa: E402
from research.riddle_paper.context import ContextReader  # noqa: E402
from research.riddle_paper.images import PaperImage, image_of, ranges_of  # noqa: E402
from research.riddle_paper.moved import MovedPoints  # noqa: E402
from research.riddle_paper.net import NetShape, RiddlePaper  # noqa: E402
from tests.research.riddle_paper.scenes import toy_frame, toy_ranges  # noqa: E402
from tests.sweeps import sampled  # noqa: E402


def a_predictor(temporal: int = 0) -> Predictor:
    """An untrained one: it predicts badly, but what has to hold must hold for any weights."""
    runs.seed_torch(11)
    return Predictor(RiddlePaper(NetShape(temporal=temporal)), torch.device("cpu"))


@pytest.mark.parametrize("coder", sampled(CODERS, [next(iter(CODERS))]))
@pytest.mark.parametrize("step", sampled([10, 50], [50]))
def test_an_image_comes_back_from_its_bytes_and_its_mask(coder: str, step: int) -> None:
    ranges_m = toy_ranges(8, 8, 24)
    image, predictor = PaperImage.plain(ranges_m, step), a_predictor()
    data = encode_image(image, predictor, coder=coder)
    unknown = image.with_cells(np.where(image.valid, 12345, 0).astype(np.int32))  # nothing of it may be used
    came = decode_image(data, unknown, predictor, coder=coder)
    assert np.array_equal(came.cells, image.cells)
    apart = np.abs(came.cells * came.step_m - ranges_m)[image.valid]
    assert apart.max() <= image.step_m / 2 + 1e-9


@pytest.mark.sweep
def test_a_frame_comes_back_with_the_scan_before_as_context() -> None:
    shape = (64, 24)
    ranges = (toy_ranges(9, *shape).clip(0, 100) * 500).astype(np.uint16)
    earlier = (toy_ranges(10, *shape).clip(0, 100) * 500).astype(np.uint16)
    frame, before = toy_frame(ranges), toy_frame(earlier)
    points = MovedPoints(before, ranges_of(image_of(before, 10), before), Motion(shift=(-8000, 0, 0)), count=6)
    image, predictor = image_of(frame, 10), a_predictor(temporal=6)
    data = encode_image(image, predictor, points)
    came = decode_image(data, image.with_cells(np.zeros_like(image.cells)), predictor, points)
    sent = ranges_of(came, frame)
    assert np.abs(sent.astype(int) - frame.range)[frame.valid].max() <= 5
    assert not sent[~frame.valid].any()
    alone = decode_image(data, image, predictor, None)
    assert not np.array_equal(alone.cells, image.cells)  # it did use the scan before


def test_a_prediction_does_not_change_with_what_comes_later() -> None:
    image, predictor = PaperImage.plain(toy_ranges(12, 12, 30), 10), a_predictor()
    everywhere = np.arange(12 * 30).reshape(12, 30)
    rng = np.random.default_rng(3)
    for _ in range(10):
        row, column = int(rng.integers(12)), int(rng.integers(30))
        later = (everywhere >= row * 30 + column) & image.valid
        changed = image.with_cells(np.where(later, image.cells + 700, image.cells).astype(np.int32))
        here = np.array([row]), np.array([column])
        one = predictor.predict(ContextReader(image).read(*here), image)
        assert np.array_equal(one, predictor.predict(ContextReader(changed).read(*here), changed))


@pytest.mark.sweep
def test_what_is_measured_is_what_is_coded() -> None:
    image, predictor = PaperImage.plain(toy_ranges(13, 12, 30), 10), a_predictor()
    guess = predictor.predict_all(image)
    reader, slow = ContextReader(image, complete=False), np.zeros_like(image.cells)
    for row in range(12):  # one cell after the other, in raster order, as nobody would
        for column in range(30):
            here = np.array([row]), np.array([column])
            reader.arrive(*here)
            if image.valid[row, column]:
                slow[here] = predictor.predict(reader.read(*here), image)
            reader.see(*here, image.cells[here])
    assert np.abs(guess - slow).max() <= 1  # a float may round the other way in another batch
    assert (guess != slow).mean() < 0.01


def test_an_image_without_returns_is_no_trouble() -> None:
    for shape in ((3, 5), (1, 1), (64, 0)):
        image, predictor = PaperImage.plain(np.zeros(shape), 10), a_predictor()
        assert np.array_equal(decode_image(encode_image(image, predictor), image, predictor).cells, image.cells)


@pytest.mark.sweep
def test_bad_bytes_give_an_error_of_ours() -> None:
    image, predictor = PaperImage.plain(toy_ranges(14, 6, 30), 10), a_predictor()
    for coder in CODERS:
        data = encode_image(image, predictor, coder=coder)
        for case in (b"", data[:5], b"\xff" * 40):
            with pytest.raises(DecodeError):
                decode_image(case, image, predictor, coder=coder)
    with pytest.raises(UnknownNameError, match="sparse, varint"):
        encode_image(image, predictor, coder="huffman")
