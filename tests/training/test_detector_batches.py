"""What the detector learns from: a view that shows another place than its boxes would teach it nonsense."""

from __future__ import annotations

import numpy as np
import pytest

from lidarcodec.evaluation.detection.detector.network import KINDS
from lidarcodec.evaluation.detection.detector.view import CELL_M, CELLS, DEPTH_M, LAYERS, OUT_M
from lidarcodec.training.detector_data import Example, examples_of

torch = pytest.importorskip("torch", reason="needs the extra learned")


def _example(*, whole: bool, kind: int = 0) -> Example:
    """A box of returns 12 m ahead: a car 4 m long and 2 m wide, turned by 0.5."""
    rng = np.random.default_rng(1)
    inside = rng.uniform(-0.5, 0.5, (4000, 3)) * [4, 2, 1]
    turn = np.array([[np.cos(0.5), np.sin(0.5)], [-np.sin(0.5), np.cos(0.5)]])
    points = np.concatenate([inside[:, :2] @ turn + [12, 2], inside[:, 2:] - 1], axis=1).astype(np.float32)
    boxes = np.array([[12, 2, -1, 4, 2, 1, 0.5]], np.float32)
    return Example(points, np.full(4000, 100, np.uint8), boxes, np.array([kind]), whole)


@pytest.mark.parametrize("whole", [False, True])
def test_boxes_lie_where_their_returns_are_seen_however_a_view_is_turned(whole: bool) -> None:
    from lidarcodec.training.detector_batches import Examples

    given, seen = Examples([_example(whole=whole)], torch.device("cpu")), 0
    for seed in range(30):
        batch = given.batch(np.zeros(2, np.int64), np.random.default_rng(seed))
        for at in range(2):
            places = np.argwhere(batch.view[at, :LAYERS].amax(dim=0).numpy())
            middles = np.argwhere(batch.heat[at, 0].numpy() == 1)
            if not len(middles) or len(places) < 100:
                continue
            seen += 1
            x, y = (middles[0] + 0.5) * OUT_M - [0, DEPTH_M / 2] + batch.box[at, :2, *middles[0]].numpy() * OUT_M
            centre = (places.min(axis=0) + places.max(axis=0) + 1) / 2 * CELL_M - [0, DEPTH_M / 2]
            assert np.hypot(x - centre[0], y - centre[1]) < 0.3
            size = np.exp(batch.box[at, 3:6, *middles[0]].numpy())
            np.testing.assert_allclose(size, [4, 2, 1], rtol=0.06)
            angle = np.arctan2(*batch.box[at, 6:8, *middles[0]].numpy()) / 2
            spread = np.cov(((places + 0.5) * CELL_M).T)
            across = np.linalg.eigh(spread)[1][:, 0]
            assert abs(across @ [np.cos(angle), np.sin(angle)]) < 0.1
    assert seen > 8


def test_what_is_neither_to_be_found_nor_to_be_left_out_weighs_nothing() -> None:
    from lidarcodec.training.detector_batches import Examples

    batch = Examples([_example(whole=False, kind=-1)], torch.device("cpu")).batch(
        np.zeros(1, np.int64), np.random.default_rng(3)
    )
    places = np.argwhere(batch.view[0, :LAYERS].amax(dim=0).numpy())
    middle = ((places.min(axis=0) + places.max(axis=0)) / 2 * CELL_M / OUT_M).astype(int)
    assert batch.weight[0, :, *middle].sum() == 0
    assert batch.weight[0].sum() > 1000
    assert batch.heat.sum() == 0


def test_views_are_those_of_the_detector() -> None:
    from lidarcodec.evaluation.detection.detector.view import seen
    from lidarcodec.training.detector_batches import Examples, _Chance, _view

    example = next(examples_of("sim:street?frames=1"))
    chance = _Chance(*(torch.tensor([value]) for value in (1.0, 0.0, 1.0, 1.0, 0.0, 1.0)))
    of = torch.zeros(len(example.points), dtype=torch.long)
    given = Examples([example], torch.device("cpu"))
    assert len(given) == 1
    view = _view(1, of, chance.moved(torch.from_numpy(example.points), of), torch.from_numpy(example.intensity).float())
    np.testing.assert_allclose(view[0].numpy(), seen(example.points, example.intensity), atol=1e-5)
    assert view.shape[-1] == CELLS


@pytest.mark.sweep
def test_the_network_learns_and_says_the_same_without_torch(tmp_path) -> None:
    from lidarcodec.evaluation.detection.detector.network import Network
    from lidarcodec.evaluation.detection.detector.view import seen
    from lidarcodec.training.train_detector import DetectorRun, train_detector

    losses: list[float] = []
    example = _example(whole=False)
    net = train_detector(
        [example], tmp_path / "d.pt", DetectorRun(steps=8, batch=2), "cpu", lambda step, loss: losses.append(loss)
    )
    assert losses[-1] < losses[0]
    view = seen(example.points, example.intensity)
    with torch.no_grad():
        expected = net(torch.from_numpy(view)[None])[0].numpy()
    found = Network(net.folded(), {})(view)
    assert found.shape[0] == len(KINDS) + 8
    np.testing.assert_allclose(found, expected, atol=1e-3)
