"""The figures that papers on point clouds compare with: written a second time here, straight from the definitions, and
without a search tree. If they were off, every comparison of ours with other people's work would be."""

import math

import numpy as np
import pytest

from lidarcodec.evaluation.geometry import MPEG_PEAK_M, NEIGHBOURS, PAPERS_PEAK_M, Cloud, CloudErrors, carried_normals


def apart(a, b):
    """(N, M) distances of every point to every other."""
    return np.sqrt(((a[:, None, :] - b[None, :, :]) ** 2).sum(axis=2))


def slow_normals(points):
    out = []
    for point, distances in zip(points, apart(points, points), strict=True):
        near = points[np.argsort(distances, kind="stable")[:NEIGHBOURS]]
        _, vectors = np.linalg.eigh(np.cov(near.T))
        normal = vectors[:, 0]
        out.append(-normal if normal @ point > 0 else normal)
    return np.array(out)


def slow_psnr(mse, peak):
    return 10 * math.log10(3 * peak * peak / mse)


def slow_figures(original, decoded):
    """Chamfer, point-to-plane, D1, D2: loops over points, as the definitions are written."""
    far = apart(original, decoded)
    normals = slow_normals(original)
    there, back = far.argmin(axis=1), far.argmin(axis=0)
    chamfer = max(far.min(axis=1).mean(), far.min(axis=0).mean())
    d1 = max((far.min(axis=1) ** 2).mean(), (far.min(axis=0) ** 2).mean())
    of_decoded = []
    for at in range(len(decoded)):
        mine = [normals[i] for i in range(len(original)) if there[i] == at]
        of_decoded.append(np.mean(mine, axis=0) if mine else normals[back[at]])
    forth = [((original[i] - decoded[j]) @ of_decoded[j]) ** 2 for i, j in enumerate(there)]
    plane = [((original[i] - decoded[j]) @ normals[i]) ** 2 for i, j in enumerate(there)]
    home = [((decoded[j] - original[i]) @ normals[i]) ** 2 for j, i in enumerate(back)]
    return {
        "chamfer_m": chamfer,
        "point_to_plane_psnr_db": slow_psnr(max(np.mean(plane), np.mean(home)), PAPERS_PEAK_M),
        "d1_psnr_db": slow_psnr(d1, MPEG_PEAK_M),
        "d2_psnr_db": slow_psnr(max(np.mean(forth), np.mean(home)), MPEG_PEAK_M),
    }


def measured(original, decoded):
    errors = CloudErrors()
    errors.add(original, decoded)
    return errors.result()


def rough_ground(random, count):
    """Points on a wavy floor under a sensor at the origin."""
    flat = random.uniform(-20, 20, (count, 2))
    height = -1.7 + 0.2 * np.sin(flat[:, 0]) + random.normal(0, 0.01, count)
    return np.column_stack([flat, height])


@pytest.mark.parametrize("shift", [0.02, 0.5])
def test_all_four_are_what_the_definitions_say(shift):
    random = np.random.default_rng(7)
    original = rough_ground(random, 300)
    decoded = original + random.normal(0, shift, original.shape)
    found = measured(original, decoded)
    assert found == pytest.approx(slow_figures(original, decoded), rel=1e-4, abs=1e-6)


def test_they_are_so_for_clouds_of_different_sizes():
    random = np.random.default_rng(8)
    original = rough_ground(random, 260)
    decoded = np.concatenate([original[::3] + 0.05, rough_ground(random, 20)])
    found = measured(original, decoded)
    assert found == pytest.approx(slow_figures(original, decoded), rel=1e-4, abs=1e-6)


def test_by_hand_a_floor_that_sinks_by_ten_centimetres():
    """Nearest points lie straight below: 0.1 m along the normal. D1 and D2 over 30 m, point-to-plane over 59.70 m."""
    x, y = np.meshgrid(np.arange(-5.0, 6.0), np.arange(-5.0, 6.0))
    floor = np.column_stack([x.ravel(), y.ravel(), np.full(x.size, -2.0)])
    found = measured(floor, floor - np.array([0, 0, 0.1]))
    assert found["chamfer_m"] == pytest.approx(0.1)
    assert found["d1_psnr_db"] == pytest.approx(10 * math.log10(3 * 900 / 0.01), abs=1e-3)
    assert found["d2_psnr_db"] == pytest.approx(found["d1_psnr_db"], abs=1e-3)
    assert found["point_to_plane_psnr_db"] == pytest.approx(10 * math.log10(3 * 59.70**2 / 0.01), abs=1e-3)


def test_points_that_slide_along_a_plane_cost_d1_and_not_d2():
    x, y = np.meshgrid(np.arange(-5.0, 6.0), np.arange(-5.0, 6.0))
    floor = np.column_stack([x.ravel(), y.ravel(), np.full(x.size, -2.0)])
    found = measured(floor, floor + np.array([0.1, 0, 0]))
    assert found["d1_psnr_db"] < 55
    assert found["d2_psnr_db"] is None or found["d2_psnr_db"] > 150


def test_the_worse_direction_counts():
    """Half of the points are gone: the decoded ones are where they were, the others have lost their place."""
    line = np.column_stack([np.arange(20.0), np.zeros(20), np.full(20, 3.0)])
    found = measured(line, line[::2])
    assert found["chamfer_m"] == pytest.approx(0.5)
    assert found["d1_psnr_db"] == pytest.approx(10 * math.log10(2700 / 0.5), abs=1e-3)


def test_no_error_is_no_number_and_an_empty_cloud_none_at_all():
    random = np.random.default_rng(9)
    cloud = rough_ground(random, 50)
    same = measured(cloud, cloud)
    assert same == {"chamfer_m": 0, "point_to_plane_psnr_db": None, "d1_psnr_db": None, "d2_psnr_db": None}
    assert set(measured(cloud, np.empty((0, 3))).values()) == {None}
    assert set(measured(np.empty((0, 3)), np.empty((0, 3))).values()) == {None}


def test_one_lost_frame_spoils_all_of_a_stream_and_not_nothing():
    random = np.random.default_rng(10)
    cloud = rough_ground(random, 50)
    errors = CloudErrors()
    errors.add(cloud, cloud + 0.01)
    errors.add(np.empty((0, 3)), np.empty((0, 3)))
    assert errors.result()["chamfer_m"] is not None
    errors.add(cloud, np.empty((0, 3)))
    assert errors.result()["chamfer_m"] is None


@pytest.mark.parametrize("count", [1, 2, 4])
def test_clouds_of_a_few_points_have_no_normals_and_no_crash(count):
    points = np.arange(3.0 * count).reshape(count, 3)
    assert np.array_equal(Cloud(points).normals(), np.zeros((count, 3)))
    found = measured(points, points + 1.0)
    assert found["d1_psnr_db"] is not None
    assert found["d2_psnr_db"] is None


def test_normals_look_towards_the_sensor():
    random = np.random.default_rng(11)
    points = rough_ground(random, 200)
    normals = Cloud(points).normals()
    assert np.einsum("ij,ij->i", normals, points).max() <= 0
    assert np.linalg.norm(normals, axis=1) == pytest.approx(np.ones(200))


def test_a_decoded_point_takes_the_mean_of_the_normals_that_come_to_it():
    normals = np.array([[1.0, 0, 0], [0, 1.0, 0], [0, 0, 1.0]])
    there, back = np.array([0, 0, 0]), np.array([1, 2])
    found = carried_normals(normals, there, back)
    assert found == pytest.approx(np.array([[1 / 3, 1 / 3, 1 / 3], [0, 0, 1]]))
