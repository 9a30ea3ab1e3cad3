"""`bench` beyond a sweep: curves of codecs with different knobs, and peers, from one command."""

import json
import sys

import pytest

from lidarcodec.codecs import table
from lidarcodec.commands.bench import command
from lidarcodec.commands.bench.curve import POINTS, curve, knob_of
from lidarcodec.errors import MissingExtraError, SettingsError, UnknownNameError
from lidarcodec.evaluation import plots

SOURCE = "sim:city?frames=3"
ONE = {"frames": 1, "skip": 0, "calibration": None, "poses": None, "plot": None}


def bench(capsys, codecs, pairs=(), **more):
    given = ONE | {"as_json": True} | more
    command.run(SOURCE, codecs=codecs, pairs=list(pairs), **given)
    shown = capsys.readouterr()
    return json.loads(shown.out), shown.err


@pytest.mark.parametrize("name", table.names())
def test_every_codec_that_can_trade_bits_for_error_has_a_curve(name):
    knob = knob_of(name)
    settings = curve(name, ["intensity=off"])
    assert len(settings) == (1 if knob is None else len(POINTS[knob]))
    assert {chosen.intensity for chosen in settings} == {"off"}
    if name != "raw":
        assert knob is not None


@pytest.mark.sweep
def test_a_codec_that_learns_is_measured_while_it_does(capsys):
    """What training in a stream costs and brings is told without a vehicle, and the same again."""
    first, again = (bench(capsys, "riddle", ["intensity=off"], frames=3, learn=7, as_json=True)[0][0] for _ in range(2))
    assert first["learned"]["steps"] == 14
    assert first["bits_per_point"] == again["bits_per_point"]
    assert "learned" not in bench(capsys, "riddle", frames=1)[0][0]
    assert "learned" not in bench(capsys, "zstd", frames=1, learn=7)[0][0]


@pytest.mark.sweep
def test_codecs_with_different_knobs_run_in_one_command_and_are_drawn(capsys, tmp_path, monkeypatch):
    monkeypatch.setitem(POINTS, "max_error_m", (0.0, 0.02, 0.1))
    monkeypatch.setitem(POINTS, "quality", (20, 90))
    picture = tmp_path / "curves.png"
    found, _ = bench(capsys, "zstd,jpeg", ["intensity=off"], as_curve=True, plot=picture)
    assert [entry["codec"] for entry in found] == ["zstd"] * 3 + ["jpeg"] * 2
    for name in ("zstd", "jpeg"):
        errors = [entry["rmse_m"] for entry in found if entry["codec"] == name]
        assert errors == sorted(errors, reverse=name == "jpeg")
    assert picture.stat().st_size > 10_000


@pytest.mark.parametrize(
    ("codecs", "pairs", "field"),
    [("jpeg", ["quality=50"], "quality"), ("pcodec", ["max_error_m=0.1"], "max_error_m"),
     ("pcodec", ["target_kbps=2000"], "target_kbps"), ("zstd,", [], "--codec")],
)  # fmt: skip
def test_a_curve_does_not_take_its_own_knob_from_outside(codecs, pairs, field):
    with pytest.raises((SettingsError, UnknownNameError), match=field):
        curve(codecs, pairs)


def test_peers_stand_beside_codecs_in_one_array(capsys):
    found, _ = bench(capsys, "zstd,peer:zstd", ["intensity=off"])
    assert [entry["codec"] for entry in found] == ["zstd", "peer:zstd", "peer:zstd"]
    assert found[0].keys() == found[1].keys()


@pytest.mark.sweep
def test_a_peer_that_is_not_installed_is_left_out_by_name_and_refused_when_it_was_asked_for(capsys, monkeypatch):
    monkeypatch.setitem(sys.modules, "DracoPy", None)
    monkeypatch.delitem(sys.modules, "lidarcodec.evaluation.peers.draco", raising=False)
    kept = {name: module for name, module in command.table._TABLE.items() if name in ("peer:zstd", "peer:draco")}
    monkeypatch.setattr(command.table, "_TABLE", kept)
    found, complaint = bench(capsys, "zstd", peers=True)
    assert [entry["codec"] for entry in found] == ["zstd", "peer:zstd", "peer:zstd"]
    assert complaint.startswith("not measured: peer:draco (DracoPy is not installed)")
    with pytest.raises(MissingExtraError, match="DracoPy"):
        bench(capsys, "peer:draco")


def test_settings_without_a_codec_to_take_them_are_refused(capsys):
    with pytest.raises(SettingsError, match="peers have no settings"):
        bench(capsys, "peer:zstd", ["intensity=off"])
    with pytest.raises(SettingsError, match="usual or all"):
        bench(capsys, "zstd", metrics="most")


@pytest.mark.sweep
def test_all_metrics_are_there_when_asked_for_and_only_then(capsys):
    more = {"range_errors", "intensity_rmse", "intensity_psnr_db", "chamfer_m", "point_to_plane_psnr_db", "d1_psnr_db",
            "d2_psnr_db", "filled"}  # fmt: skip
    usual, _ = bench(capsys, "pcodec", ["max_error_m=0.05"])
    found, _ = bench(capsys, "pcodec", ["max_error_m=0.05"], metrics="all")
    assert found[0].keys() - usual[0].keys() == more
    assert 0 < found[0]["chamfer_m"] < 0.05
    assert found[0]["point_to_plane_psnr_db"] - found[0]["d2_psnr_db"] == pytest.approx(5.98, abs=0.3)
    assert sum(band["returns"] for band in found[0]["range_errors"]) == found[0]["points"]
    assert max(band["max_m"] or 0 for band in found[0]["range_errors"]) == found[0]["max_error_m"]


@pytest.mark.sweep
def test_the_table_to_read_shows_peers_and_more_metrics(capsys):
    command.run(SOURCE, codecs="raw,peer:lerc", pairs=[], **ONE, as_json=False, metrics="all")
    shown = capsys.readouterr().out
    assert "peer:lerc max_error_m=0.05" in shown
    assert "chamfer mm" in shown
    assert "filled mm" in shown


@pytest.mark.sweep
def test_what_a_receiver_fills_in_and_how_far_intensity_is_off_is_told(capsys):
    pairs = ["reduction=lattice:4", "max_error_m=0.02", "intensity=lossless,levels=8,off"]
    exact, shades, none = bench(capsys, "zstd", pairs, metrics="all")[0]
    assert exact["filled"]["chamfer_m"] < 0.8 * exact["chamfer_m"]
    assert (exact["intensity_rmse"], exact["intensity_psnr_db"]) == (0, None)
    assert 0 < shades["intensity_rmse"] < none["intensity_rmse"]
    assert shades["intensity_psnr_db"] > none["intensity_psnr_db"] > 0


@pytest.mark.sweep
def test_with_all_metrics_a_curve_is_the_operating_curve_of_a_target(capsys, tmp_path, monkeypatch):
    monkeypatch.setattr("lidarcodec.commands.bench.curve.TARGETS_KBPS", (700, 4000))
    monkeypatch.setattr(sys.modules[__name__], "SOURCE", "sim:road?seed=2&frames=3")
    picture = tmp_path / "operating.svg"
    found, _ = bench(capsys, "pcodec", frames=3, as_curve=True, metrics="all", plot=picture)
    assert [entry["settings"]["target_kbps"] for entry in found] == [700, 4000]
    low, high = found
    assert low["kbps_at_10hz"] < high["kbps_at_10hz"]
    assert low["filled"]["chamfer_m"] > high["filled"]["chamfer_m"]
    for entry in found:
        told = entry["localisation"]
        assert told["of"] >= 1
        assert told["bad"] <= told["of"]
        assert told["mate_m"] is None or 0 < told["mate_m"] < 0.3
    text = picture.read_text()
    for title in ("Chamfer", "D2", "PSNR of intensity", "share of the returns", "frames a second", "localisation"):
        assert title in text
    with pytest.raises(SettingsError, match="target_kbps"):
        bench(capsys, "pcodec", ["target_kbps=300"], as_curve=True, metrics="all")


@pytest.mark.sweep
def test_where_a_drive_says_nothing_of_its_way_the_rest_of_the_curve_is_drawn_all_the_same(capsys, monkeypatch):
    monkeypatch.setattr("lidarcodec.commands.bench.curve.TARGETS_KBPS", (2000,))
    (found,), _ = bench(capsys, "zstd", as_curve=True, metrics="all")
    assert found["localisation"] is None, "one frame is no drive"
    assert found["chamfer_m"] > 0


@pytest.mark.sweep
def test_a_picture_of_bits_shows_peers_in_one_piece(capsys, tmp_path):
    picture = tmp_path / "bits.svg"
    bench(capsys, "raw,peer:zstd,peer:lerc", plot=picture)
    text = picture.read_text()
    assert "not split" in text
    assert plots.UNSPLIT in text
