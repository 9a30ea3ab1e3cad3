"""`map compress --by learned`: windows cover the map, weights of anybody are checked, and training learns something."""

from __future__ import annotations

import io
import json

import numpy as np
import pytest

from lidarcodec.errors import SettingsError, SourceError
from lidarcodec.maps.compress import bare, compressed
from lidarcodec.maps.file import write_map
from lidarcodec.maps.select.point_net import LAYERS, Layer, read_point_net
from lidarcodec.maps.select.table import method
from lidarcodec.maps.select.windows import SIZE, coordinates, halves, windows_of
from lidarcodec.untrusted.network_weights import packed
from tests.command_line import run_here, the_one_line
from tests.maps.towns import street

TOWN = street(length_m=30.0)


def random_layers(seed=1):
    random = np.random.default_rng(seed)
    return {
        name: Layer(
            random.normal(0, inputs**-0.5, (outputs, inputs)).astype(np.float32),
            random.normal(0, 0.1, outputs).astype(np.float32),
        )
        for name, (inputs, outputs) in LAYERS.items()
    }


@pytest.fixture(scope="module")
def weights(tmp_path_factory):
    path = tmp_path_factory.mktemp("weights") / "points.npz"
    path.write_bytes(packed(random_layers(), {"trained_on": "nothing", "licence": "Apache-2.0"}, LAYERS))
    return path


def test_each_point_is_in_one_window_of_neighbours_along_the_path():
    windows = windows_of(TOWN)
    assert windows.shape == (-(-len(TOWN) // SIZE), SIZE)
    assert np.array_equal(np.unique(windows), np.arange(len(TOWN)))
    assert np.ptp(TOWN.xyz[windows[0]][:, 0]) < 10
    cube = coordinates(TOWN, windows)
    assert cube.min() == 0
    assert np.allclose(cube.max(axis=(1, 2)), 1)
    first, second = halves(TOWN)
    assert len(first) + len(second) == len(TOWN)
    assert first.xyz[:, 0].max() <= second.xyz[:, 0].min() + 0.1


@pytest.mark.sweep
def test_a_map_is_compressed_by_weights_of_ones_own_and_they_say_what_they_were_trained_on(weights):
    made, about = compressed(TOWN, "learned", 500, select=method("learned", weights))
    assert (len(made), about["trained_on"]) == (500, "nothing")
    assert {*map(tuple, made.steps.tolist())} <= {*map(tuple, TOWN.steps.tolist())}
    with pytest.raises(SettingsError, match="map build"):
        compressed(bare(TOWN), "learned", 500, select=method("learned", weights))
    with pytest.raises(SettingsError, match="only for --by learned"):
        method("greedy", weights)


def test_weights_that_are_damaged_or_none_are_refused_with_a_sentence(weights, tmp_path):
    whole = weights.read_bytes()
    wrong = {name: layer for name, layer in random_layers().items() if name != "out"}
    arrays = {"about": np.frombuffer(b"{}", np.uint8), "a.weights": np.zeros((64, 3), np.float32)}
    missing = io.BytesIO()
    np.savez(missing, **arrays)
    for data in (b"", whole[:-100], whole[: len(whole) // 2], b"PK" + whole[4:], missing.getvalue()):
        path = tmp_path / "w.npz"
        path.write_bytes(data)
        with pytest.raises(SourceError, match=r"w\.npz"):
            read_point_net(path, "w.npz")
    with pytest.raises(SourceError, match="cannot read the weights"):
        read_point_net(tmp_path / "none.npz", "none.npz")
    with pytest.raises(KeyError):
        packed(wrong, {}, LAYERS)


@pytest.mark.timeout(600)  # a busy machine takes minutes to load torch
@pytest.mark.sweep
def test_the_network_without_torch_is_that_of_training(weights):
    torch = pytest.importorskip("torch", reason="needs the extra `learned`")
    from lidarcodec.training.nets.map_point_net import MapPointNet

    torch.manual_seed(1)
    net = MapPointNet(LAYERS)
    windows = torch.from_numpy(coordinates(TOWN, windows_of(TOWN)[:2]))
    net.train()
    net(windows)  # means and deviations are those of these
    net.eval()
    with torch.no_grad():
        wanted = net(windows)[0].numpy()
    layers = {name: Layer(*layer) for name, layer in net.folded().items()}
    file = io.BytesIO(packed(layers, {}, LAYERS))
    ready = read_point_net(file, "it")
    found = np.stack([ready.logits(window) for window in windows.numpy()])
    assert np.corrcoef(found.ravel(), wanted.ravel())[0, 1] > 0.99


@pytest.mark.sweep
@pytest.mark.timeout(600)  # a busy machine takes minutes to load torch
def test_the_command_trains_goes_on_and_writes_weights_that_compress_takes(tmp_path):
    pytest.importorskip("torch", reason="needs the extra `learned`")
    pytest.importorskip("highspy", reason="needs the extra `maps`")
    town, small, weights = tmp_path / "town.lcmap", tmp_path / "small.lcmap", tmp_path / "own.npz"
    with town.open("wb") as file:
        write_map(file, street(length_m=10.0, per_m2=10.0))
    words = ["train", "map-points", town, "--out", tmp_path / "own.pt", "--weights", weights, "--note", "a street"]
    for epochs in (1, 1):  # the second time nothing is left to do
        done = run_here(*words, "--epochs", epochs, "--force", "--json")
        assert done.returncode == 0, done.stderr
        found = json.loads(done.stdout)
        assert (found["epochs"], len(found["log"])) == (1, 1)
        assert 0 < found["log"][0]["loss"] < 1
        assert 0 <= found["tests"][str(town)] <= 1
    done = run_here("map", "compress", town, "-o", small, "--keep", "10%", "--by", "learned", "--weights", weights)
    assert done.returncode == 0, done.stderr
    assert "trained on a street" in done.stdout
    done = run_here("map", "compress", town, "-o", small, "--keep", "10%", "--by", "learned", "--force")
    assert done.returncode == 2
    assert "train map-points" in the_one_line(done)
