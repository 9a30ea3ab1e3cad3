"""The reference that everything is compared with: if it were off by a centimetre, methods that differ by two
millimetres could not be told apart, and nobody would see it in the figures."""

import numpy as np
import pytest

from lidarcodec.errors import SettingsError, SourceError
from lidarcodec.evaluation.localisation.coding import with_odometry
from lidarcodec.evaluation.localisation.drive import read_drive
from lidarcodec.evaluation.localisation.errors import pose_errors
from lidarcodec.evaluation.localisation.maps import merged
from lidarcodec.evaluation.localisation.reference import find_reference
from lidarcodec.evaluation.trajectory import near


@pytest.fixture(scope="module")
def street():
    return read_drive("sim:street?packets=3828&traffic=0")


@pytest.fixture(scope="module")
def exact(street):
    return find_reference(street)


@pytest.mark.sweep
def test_cut_turns_at_the_ends_are_left_out(street):
    widths = [frame.width for frame in street.frames]
    assert len(widths) == 10
    assert min(widths) > 2100
    assert np.diff(street.stamps_ns) == pytest.approx(103.4e6, rel=0.02)


def test_a_drive_with_too_little_in_it_is_refused():
    with pytest.raises(SourceError, match="complete frames"):
        read_drive("sim:street?frames=1")


def test_what_was_decoded_is_deskewed_by_the_times_of_the_original(street, exact):
    """A reduced frame begins and ends at other returns: its own middle would be another moment, and at 12 m/s each
    millisecond is 12 mm."""
    frame = street.frames[4]
    keep = np.zeros(frame.range.shape, bool)
    keep[:, 100:900] = True
    part = street.cloud(4, exact.velocities[4], frame.with_(keep=keep))
    whole = street.cloud(4, exact.velocities[4])
    assert len(part) < len(whole) / 2
    inside = {tuple(point) for point in np.round(whole, 4)}
    assert np.mean([tuple(point) in inside for point in np.round(part, 4)]) > 0.99
    assert len(near(part)) > 0.99 * len(part)


def test_exact_poses_are_taken_where_there_are(street, exact):
    assert (exact.kind, exact.noise) == ("exact", None)
    assert np.linalg.norm(exact.velocities[:, :3], axis=1) == pytest.approx(np.full(10, 12.0), abs=0.6)
    ahead = exact.at(3, float(street.stamps_ns[4] - street.stamps_ns[3]) * 1e-9)
    assert pose_errors(ahead[None], exact.poses[4:5])["trans_m"][0] < 0.03


def test_poses_that_are_not_there_cannot_be_given():
    class Bare:
        name, poses, exact = "drive.pcap", None, False

    with pytest.raises(SettingsError, match="--poses"):
        find_reference(Bare(), "given")


@pytest.mark.sweep
def test_refined_odometry_finds_an_exact_drive_to_a_centimetre_and_says_how_sure_it_is(street, exact):
    found = find_reference(street, "refined")
    assert found.kind == "refined"
    assert 1e-5 < found.noise.metres < 0.005
    assert 1e-5 < found.noise.degrees < 0.05
    assert found.about()["noise_m"] == found.noise.metres
    # the first pose is the identity in one and an estimate in the other: compare from the middle on
    own = np.linalg.inv(found.poses[5]) @ found.poses
    true = np.linalg.inv(exact.poses[5]) @ exact.poses
    errors = pose_errors(own, true)
    assert errors["trans_m"].max() < 0.025
    assert errors["angle_deg"].max() < 0.1


def test_odometry_is_off_by_five_centimetres_after_nine_tenths_of_a_second(street, exact):
    """A reducer that is told of the motion gets no better odometry than a car has, and no worse."""
    off = []
    for seed in range(60):
        frames = with_odometry(street, exact, seed)
        true = [exact.at(at, (frame.stamp_ns - int(street.stamps_ns[at])) * 1e-9) for at, frame in enumerate(frames)]
        assert pose_errors(frames[0].pose[None], true[0][None])["trans_m"][0] == 0
        way, real = np.linalg.inv(frames[0].pose) @ frames[9].pose, np.linalg.inv(true[0]) @ true[9]
        off.append(pose_errors(way[None], real[None]))
    assert np.sqrt(np.mean([one["trans_m"] ** 2 for one in off])) == pytest.approx(0.05, rel=0.2)
    assert np.sqrt(np.mean([one["angle_deg"] ** 2 for one in off])) == pytest.approx(0.1, rel=0.2)


def test_a_map_of_nothing_is_refused():
    with pytest.raises(SourceError, match="too few"):
        merged([np.zeros((3, 3))])
