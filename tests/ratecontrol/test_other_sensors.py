"""What an operator of another sensor than an HDL-64E would lose: a target kept, a bound that holds, a warning."""

from __future__ import annotations

from functools import lru_cache
from itertools import pairwise

import numpy as np
import pytest

from lidarcodec.assembly import packets_of
from lidarcodec.codecs import table
from lidarcodec.codecs.other_sensors import KINDS
from lidarcodec.frame import Frame
from lidarcodec.pipeline import StreamDecoder, StreamEncoder, frames_of
from lidarcodec.ratecontrol.curve import COARSEST_M, Pins
from lidarcodec.ratecontrol.image_curve import ImageKind, image_curve, kind_of, seconds_of
from lidarcodec.ratecontrol.reach import in_the_way, missed_warning, reach_warning
from lidarcodec.settings import settings_from, step_of
from lidarcodec.wire import pack
from tests.codecs.test_other_sensors import FILES, opened
from tests.contracts import frames as made
from tests.sweeps import sampled, spread

VLP16 = ImageKind(1.2, 1, 0.002, 150_000.0)
OS1 = ImageKind(2.0, 2, 0.008, 1_100_000.0)
KINDS_OF_IMAGES = (VLP16, OS1, ImageKind(0.1, 0, 0.001, 1.0), ImageKind(64.0, 3, 0.005, 9e6))
STEERED = [name for name in KINDS if name != "raw"]
TURN_NS = 100_000_000


@lru_cache(maxsize=4)
def turns(capture: str) -> list[Frame]:
    """The first whole turn of a capture, and the same again with some of its returns gone."""
    sensor, packets = opened(FILES[capture])
    found = list(frames_of(packets, sensor, "revolution"))
    whole = found[min(1, len(found) - 1)]
    fewer = whole.range * (np.arange(whole.width) % 9 > 0).astype(np.uint32)
    return [whole, whole.with_(range=fewer)]


def stream(capture: str, count: int) -> list[Frame]:
    """So many turns, ten a second."""
    of = turns(capture)
    return [of[k % 2].with_(index=k, stamp_ns=10**18 + k * TURN_NS) for k in range(count)]


@pytest.mark.parametrize(
    ("purpose", "codec", "kind"), spread(["look", "localise", "detect", "archive"], STEERED, KINDS_OF_IMAGES)
)
def test_along_a_curve_more_bits_never_show_less(kind: ImageKind, codec: str, purpose) -> None:
    for pins in (Pins(), Pins(step=7), Pins(levels=9), Pins(bound_m=0.05), Pins(step=1, levels=256, bound_m=0.0)):
        curve = image_curve(codec, pins._replace(purpose=purpose), kind)
        assert (np.diff(curve.bits) > 0).all()
        assert (np.diff(curve.cost) < 0).all()
        for one, other in pairwise(curve.points):
            assert other.step <= one.step
        for name in ("chamfer_m", "shades"):
            assert (np.diff(getattr(curve, name)) <= 0).all()
        for point in curve.points:
            assert pins.step in (None, point.step)
            assert pins.levels in (None, point.levels)
            assert point.value <= (COARSEST_M if pins.bound_m is None else pins.bound_m)
            assert (step_of(point.value, kind.range_step_m) - 1) // 2 * kind.range_step_m == pytest.approx(point.value)


@pytest.mark.parametrize(
    ("capture", "codec", "kbps"),
    sampled(
        [
            ("vlp16", "predictive", 700),
            ("vlp16", "zstd", 400),
            ("vlp16", "pcodec", 300),
            ("xt32m", "predictive", 80),
            ("OS-0-32-U1_v2.2.0_1024x10", "predictive", 1500),
        ],
        [("vlp16", "zstd", 400), ("vlp16", "pcodec", 300), ("xt32m", "predictive", 80)],
    ),
)
def test_a_target_is_kept_and_no_range_is_further_off_than_is_said(capture: str, codec: str, kbps: float) -> None:
    frames = stream(capture, 30)
    encoder, decoder = StreamEncoder(settings_from({"codec": codec, "target_kbps": kbps}), 1), StreamDecoder()
    bits = []
    for frame in frames:
        (message,) = encoder.encode(frame)
        bits.append(8 * len(pack(message)))
        (decoded,) = decoder.decode(message)
        assert encoder.reduced is not None
        assert encoder.rate is not None
        kept = encoder.reduced.valid
        np.testing.assert_array_equal(decoded.range > 0, kept)
        off = np.abs(decoded.range.astype(np.int64) - frame.range)[kept]
        assert off.max() * frame.sensor.range_step_m <= min(encoder.rate["max_error_m"], COARSEST_M) + 1e-9
    assert abs(sum(bits[5:]) / (25 * 0.1) / 1e3 / kbps - 1) < 0.05
    assert encoder.rate is not None
    assert (encoder.rate["limited_by"], encoder.rate["reached"]) == ("target", True)


@pytest.mark.parametrize(
    ("capture", "codec", "kbps"),
    sampled(
        [
            ("vlp16", "png", 700),
            ("vlp16", "jxl", 600),
            ("vlp16", "jpeg", 400),
            ("vlp16", "h264-log", 200),
            ("OS-0-32-U1_v2.2.0_1024x10", "h264", 1000),
            ("xt32m", "jpeg-layered", 150),
        ],
        [("vlp16", "jpeg", 400), ("vlp16", "h264-log", 200)],
    ),
)
def test_a_target_is_kept_with_codecs_of_pictures_too(capture: str, codec: str, kbps: float) -> None:
    if codec not in table.installed():
        pytest.skip(f"codec {codec} is not installed")
    encoder, decoder = StreamEncoder(settings_from({"codec": codec, "target_kbps": kbps}), 1), StreamDecoder()
    bits = []
    for frame in stream(capture, 40):
        messages = encoder.encode(frame)
        bits.append(sum(8 * len(pack(message)) for message in messages))
        for decoded in (one for message in messages for one in decoder.decode(message)):
            assert decoded.points
    assert abs(sum(bits[8:]) / (32 * 0.1) / 1e3 / kbps - 1) < 0.06
    assert encoder.rate is not None
    assert (encoder.rate["limited_by"], encoder.rate["reached"]) == ("target", True)


def test_a_target_below_the_least_leaves_out_frames_and_says_so() -> None:
    settings = settings_from({"codec": "predictive", "target_kbps": 400, "intensity": "lossless", "reduction": "all"})
    encoder = StreamEncoder(settings, 1)
    sent = [encoder.encode(frame) for frame in stream("vlp16", 30)]
    assert 0 < sum(not messages for messages in sent) < 30
    assert encoder.rate is not None
    assert encoder.rate["limited_by"] == "floor"
    warning = missed_warning(settings, encoder.rate, encoder.images)
    assert warning is not None
    assert (warning.code, warning.settings) == ("frames_left_out", ("intensity", "reduction"))
    assert "set intensity and reduction back" in warning.remedy


def test_what_is_expected_goes_by_the_sensor() -> None:
    settings = settings_from({"codec": "predictive", "target_kbps": 90})
    assert reach_warning(settings) is not None, "an HDL-64E needs more"
    assert reach_warning(settings, VLP16) is None
    least = reach_warning(settings.changed(target_kbps=5), VLP16)
    assert least is not None
    assert least.code == "target_out_of_reach"
    pinned = settings.changed(reduction="all", intensity="lossless")
    assert in_the_way(pinned, VLP16) == ("intensity", "reduction")
    auto = settings.changed(codec="auto", target_kbps=100)
    assert reach_warning(auto, VLP16) is None


def test_a_stream_that_follows_its_path_takes_what_that_carries() -> None:
    encoder = StreamEncoder(settings_from({"codec": "predictive", "target_kbps": "auto"}), 1)
    sizes = []
    for frame in stream("vlp16", 24):
        encoder.aim(600.0 if frame.index < 12 else 150.0)
        sizes.append(sum(8 * len(pack(message)) for message in encoder.encode(frame)))
    assert sum(sizes[4:12]) / 800 == pytest.approx(600, rel=0.1)
    assert sum(sizes[16:]) / 800 == pytest.approx(150, rel=0.1)


def test_for_a_localiser_returns_are_chosen_and_nothing_is_thinned_to_columns() -> None:
    encoder = StreamEncoder(settings_from({"codec": "predictive", "target_kbps": 150, "purpose": "localise"}), 1)
    for frame in stream("vlp16", 12):
        encoder.encode(frame)
        assert encoder.reduced is not None
        assert encoder.reduced.lattice is None
    assert encoder.reduction is not None
    assert encoder.reduction["name"] == "voxel-seen"
    assert encoder.reduction["kept"] < encoder.reduction["returns"]


def test_settings_change_in_mid_stream() -> None:
    encoder, decoder = StreamEncoder(settings_from({"codec": "predictive", "target_kbps": 300}), 1), StreamDecoder()
    changes = {
        4: {"target_kbps": None},
        8: {"target_kbps": 500},
        12: {"codec": "pcodec"},
        16: {"reduction": "random"},
        20: {"codec": "auto"},
    }
    for frame in stream("vlp16", 24):
        if frame.index in changes:
            encoder.apply(encoder.settings.changed(**changes[frame.index]))
        (decoded,) = (one for message in encoder.encode(frame) for one in decoder.decode(message))
        if 4 <= frame.index < 8:
            assert [one.payload for one in packets_of(decoded)] == [one.payload for one in packets_of(frame)]
    assert encoder.settings.codec in KINDS


def test_auto_is_a_codec_that_takes_the_sensor() -> None:
    (vlp16, _), hdl64e = turns("vlp16"), made.scene(4)
    encoder, decoder = StreamEncoder(settings_from({"codec": "auto"}), 1), StreamDecoder()
    seen = []
    for index, frame in enumerate((hdl64e, vlp16, vlp16, hdl64e)):
        for message in encoder.encode(frame.with_(index=index)):
            (decoded,) = decoder.decode(message)
            np.testing.assert_array_equal(decoded.range, frame.range)
        seen.append(encoder.settings.codec)
    assert seen[0] == seen[3]
    assert seen[1] == seen[2]
    assert seen[1] in KINDS
    fresh = StreamEncoder(settings_from({"codec": "auto"}), 1)
    assert fresh.prepare(vlp16.sensor)
    assert fresh.settings.codec == seen[1]
    assert not fresh.prepare(vlp16.sensor)


def test_what_is_known_of_images_is_of_the_whole_turn() -> None:
    for capture, spacing, attributes in (("vlp16", 1.2, 1), ("OS-0-32-U1_v2.2.0_1024x10", 2.0, 3)):
        whole = turns(capture)[0]
        kind = kind_of(whole)
        assert (kind.spacing, kind.attributes) == (spacing, attributes)
        assert kind.returns_per_s == pytest.approx(10 * whole.points, rel=0.1)
        assert seconds_of(whole) == pytest.approx(0.1, rel=0.05)
