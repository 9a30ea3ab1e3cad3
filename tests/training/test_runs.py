"""If these fail, a training run that was interrupted loses its hours, or goes on as another run than it was."""

from __future__ import annotations

import resource
from pathlib import Path

import numpy as np
import pytest

from lidarcodec.errors import MissingExtraError, SettingsError, SourceError

torch = pytest.importorskip("torch", reason="training needs torch: the extra `learned`")

from lidarcodec import training  # noqa: E402
from lidarcodec.training import runs  # noqa: E402


def a_checkpoint(step: int = 3) -> runs.Checkpoint:
    """A checkpoint of a small run, Adam's moments included."""
    runs.seed_torch(1)
    layer = torch.nn.Linear(3, 2)
    optimiser = torch.optim.Adam(layer.parameters())
    layer(torch.ones(4, 3)).sum().backward()
    optimiser.step()
    settings: dict[str, runs.Value] = {"seed": 1, "name": "small", "steps": [1, 2], "rate": 0.5, "held_out": None}
    log: list[dict[str, runs.Value]] = [{"step": 2, "loss": 0.25}]
    return runs.Checkpoint(step, settings, layer.state_dict(), optimiser.state_dict(), 12.5, log)


def test_a_checkpoint_comes_back_whole(tmp_path: Path) -> None:
    saved = a_checkpoint()
    runs.save_checkpoint(tmp_path / "new" / "run.pt", saved)
    found = runs.load_checkpoint(tmp_path / "new" / "run.pt")
    assert found is not None
    assert (found.step, found.settings, found.seconds, found.log) == (3, saved.settings, 12.5, saved.log)
    assert all(torch.equal(found.model[name], value) for name, value in saved.model.items())
    moments = saved.optimiser["state"][0]
    assert torch.equal(found.optimiser["state"][0]["exp_avg"], moments["exp_avg"])
    assert [path.name for path in (tmp_path / "new").iterdir()] == ["run.pt"]  # nothing half written stays beside it


def test_a_run_without_a_checkpoint_begins_anew(tmp_path: Path) -> None:
    assert runs.load_checkpoint(tmp_path / "run.pt") is None


def test_a_full_disk_is_said_when_a_checkpoint_is_written(tmp_path: Path) -> None:
    """torch says: [enforce fail at inline_container.cc]."""
    saved = a_checkpoint()
    runs.save_checkpoint(tmp_path / "run.pt", saved)
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1000, before[1]))
    try:
        with pytest.raises(SourceError, match=r"cannot write .*run\.pt: File too large"):
            runs.save_checkpoint(tmp_path / "run.pt", a_checkpoint(4))
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert [path.name for path in tmp_path.iterdir()] == ["run.pt"]
    found = runs.load_checkpoint(tmp_path / "run.pt")
    assert found is not None
    assert found.step == saved.step


def test_a_damaged_checkpoint_is_named_and_not_loaded(tmp_path: Path) -> None:
    path = tmp_path / "run.pt"
    runs.save_checkpoint(path, a_checkpoint())
    whole = path.read_bytes()
    for damaged in (b"", b"hello", whole[:40], whole[: len(whole) // 2], whole[:-30], b"\x80\x04N."):
        path.write_bytes(damaged)
        with pytest.raises(SourceError, match=r"run\.pt"):
            runs.load_checkpoint(path)
    torch.save({"weights": torch.ones(2)}, path)
    with pytest.raises(SourceError, match="not a checkpoint of a training run"):
        runs.load_checkpoint(path)


def test_a_checkpoint_that_would_run_code_is_refused(tmp_path: Path) -> None:
    class Trap:
        def __reduce__(self) -> tuple[object, ...]:
            return (Path.touch, (tmp_path / "sprung",))

    torch.save({"kind": "lidarcodec training run", "model": Trap()}, tmp_path / "run.pt")
    with pytest.raises(SourceError):
        runs.load_checkpoint(tmp_path / "run.pt")
    assert not (tmp_path / "sprung").exists()


def test_a_run_goes_on_only_under_its_own_settings() -> None:
    checkpoint = a_checkpoint()
    checkpoint.require(checkpoint.settings)
    checkpoint.require({**checkpoint.settings, "rate": 0.1}, may_differ=frozenset({"rate"}))
    with pytest.raises(SettingsError, match=r"rate = 0\.5, not 0\.1"):
        checkpoint.require({**checkpoint.settings, "rate": 0.1})
    with pytest.raises(SettingsError, match="extra"):
        checkpoint.require({**checkpoint.settings, "extra": 1})


def test_an_unwritable_folder_is_named(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("not a folder")
    with pytest.raises(SourceError, match="cannot write"):
        runs.save_checkpoint(tmp_path / "file" / "run.pt", a_checkpoint())


def test_a_step_draws_the_same_whenever_it_comes() -> None:
    first = runs.step_rng(1, 5).integers(0, 1 << 30, 8)
    runs.step_rng(1, 6).integers(0, 9, 100)
    assert np.array_equal(first, runs.step_rng(1, 5).integers(0, 1 << 30, 8))
    others = [runs.step_rng(2, 5), runs.step_rng(1, 6), runs.step_rng(1, 5, 1)]
    assert not any(np.array_equal(first, other.integers(0, 1 << 30, 8)) for other in others)
    runs.seed_torch(3, 4)
    drawn = torch.rand(3)
    torch.rand(5)
    runs.seed_torch(3, 4)
    assert torch.equal(drawn, torch.rand(3))


def test_the_rate_rises_then_falls_and_never_leaves_its_bounds() -> None:
    rates = [runs.rate_at(step, 50, peak=2.0, warm_up=5) for step in range(60)]
    assert rates[4] == max(rates) == 2.0
    assert rates[:5] == sorted(rates[:5])
    assert rates[5:] == sorted(rates[5:], reverse=True)
    assert rates[-1] == pytest.approx(0.006)
    assert runs.rate_at(0, 1, peak=1.0) == 1.0


def test_a_device_that_is_not_there_is_refused_by_name() -> None:
    assert runs.choose_device("cpu").type == "cpu"
    assert runs.choose_device().type in ("cpu", "cuda")
    for name in ("abacus", "cuda:99"):
        with pytest.raises(SettingsError, match=name):
            runs.choose_device(name)
    with pytest.raises(SettingsError, match="at least 1"):
        runs.limit_threads(0)


def test_without_torch_the_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    import sys

    monkeypatch.setitem(sys.modules, "torch", None)  # what Python itself does for a module that is not installed
    monkeypatch.delitem(sys.modules, "lidarcodec.training.runs")
    with pytest.raises(MissingExtraError, match="learned"):
        training.training_module("runs")
    with pytest.raises(ModuleNotFoundError, match="no_such_module"):
        training.training_module("no_such_module")
