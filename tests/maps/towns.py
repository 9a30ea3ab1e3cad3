"""Small maps for tests: a street with a ground, two walls and poles, seen from a path along it."""

import numpy as np

from lidarcodec.maps.points import MapPoints, packed_normals


def street(length_m=60.0, seed=1, step_m=0.02, per_m2=6.0):
    random = np.random.default_rng(seed)
    count = int(length_m * 10 * per_m2)
    along = random.uniform(0, length_m, (3, count))
    ground = np.stack([along[0], random.uniform(-5, 5, count), random.normal(0, 0.01, count)], axis=1)
    walls = [
        np.stack([along[at], side + random.normal(0, 0.01, count), random.uniform(0, 6, count)], axis=1)
        for at, side in ((1, -6.0), (2, 6.0))
    ]
    xyz = np.concatenate([ground, *walls])
    normals = np.repeat([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [0.0, 1.0, 0.0]], count, axis=0)
    steps, chosen = np.unique(np.rint(xyz / step_m).astype(np.int64), axis=0, return_index=True)
    a, b = packed_normals(normals[chosen])
    path = np.stack([np.arange(0.0, length_m), np.zeros(int(length_m)), np.full(int(length_m), 1.7)], axis=1)
    place = np.clip(steps[:, 0] * step_m, 0, length_m - 1)
    first = np.clip(place - 20, 0, None).astype(np.uint16)
    last = np.clip(place + 20, None, length_m - 1).astype(np.uint16)
    counts = random.integers(1, 120, len(steps)).astype(np.uint16)
    columns = {"normal_a": a, "normal_b": b, "count": counts, "first": first, "last": last}
    return MapPoints(step_m, steps, columns, path.astype(np.float32), float(length_m))


def court(half_x_m, half_y_m, seed=1, step_m=0.02, points=2500):
    """Four walls around the middle of a tile, and a ground: turned by 180 degrees it looks the same."""
    random = np.random.default_rng(seed)
    along, high = random.uniform(-1, 1, (4, points)), random.uniform(0.1, 5, points)
    sign = random.choice([-1, 1], points)
    xyz = np.concatenate([
        np.stack([half_x_m * along[0], half_y_m * along[1], np.zeros(points)], axis=1),
        np.stack([half_x_m * along[2], half_y_m * sign, high], axis=1),
        np.stack([half_x_m * sign, half_y_m * along[3], high], axis=1),
    ])  # fmt: skip
    normals = np.repeat([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]], points, axis=0)
    steps, chosen = np.unique(
        np.rint((xyz + np.array([25, 25, 0])) / step_m).astype(np.int64), axis=0, return_index=True
    )
    a, b = packed_normals(normals[chosen])
    return MapPoints(step_m, steps, {"normal_a": a, "normal_b": b})


def same_points(one, other):
    """Whether two maps have the same points with the same columns, in any order."""
    rows = [
        np.column_stack([points.steps, *(points.columns[name] for name in points.columns)]) for points in (one, other)
    ]
    rows = [found[np.lexsort(found.T)] for found in rows]
    return list(one.columns) == list(other.columns) and np.array_equal(*rows)


def town(width_m=120.0, houses=30, seed=3, step_m=0.02, per_m2=4.0):
    """A square with houses of all sizes and turns on a flat ground: no two places look alike."""
    random = np.random.default_rng(seed)
    count = int(width_m**2 * per_m2 / 2)
    xyz = [np.column_stack([random.uniform(0, width_m, (count, 2)), random.normal(0, 0.01, count)])]
    normals = [np.repeat([[0.0, 0.0, 1.0]], count, axis=0)]
    for _ in range(houses):
        middle, turn = random.uniform(0, width_m, 2), random.uniform(0, np.pi)
        for length, way in zip(random.uniform(4, 14, 2), (turn, turn + np.pi / 2), strict=True):
            points = int(length * 4 * per_m2)
            along, off = random.uniform(-length / 2, length / 2, points), random.normal(0, 0.01, points)
            ahead, aside = np.array([np.cos(way), np.sin(way)]), np.array([-np.sin(way), np.cos(way)])
            flat = middle + along[:, None] * ahead + off[:, None] * aside
            xyz.append(np.column_stack([flat, random.uniform(0, 4, points)]))
            normals.append(np.repeat([[*aside, 0.0]], points, axis=0))
    steps, chosen = np.unique(np.rint(np.concatenate(xyz) / step_m).astype(np.int64), axis=0, return_index=True)
    a, b = packed_normals(np.concatenate(normals)[chosen])
    return MapPoints(step_m, steps, {"normal_a": a, "normal_b": b}, length_m=width_m)


def open_road(posts=24, seed=1, length_m=160.0, step_m=0.02):
    """A road along x on a bumpy ground, 40 m wide, with a rail on either side, and posts that say where along it one
    is: plates half a metre wide that face it."""
    random = np.random.default_rng(seed)
    count = int(length_m * 40 * 2)
    ground = np.stack(
        [random.uniform(0, length_m, count), random.uniform(0, 40, count), random.normal(0, 0.02, count)], 1
    )
    up = random.normal((0, 0, 1), (0.05, 0.05, 0), (count, 3))
    few = int(length_m * 10)
    side = random.choice([12.0, 28.0], few)
    rails = np.stack([random.uniform(0, length_m, few), side, random.uniform(0.3, 1.2, few)], axis=1)
    at = np.repeat(
        np.stack([random.uniform(0, length_m, posts), random.choice([10.0, 30.0], posts)], axis=1), 60, axis=0
    )
    plates = np.column_stack([at + [[0, 1]] * random.uniform(-0.3, 0.3, (len(at), 1)), random.uniform(0.2, 3, len(at))])
    normals = np.concatenate([up, np.tile([0.0, 1.0, 0.0], (few, 1)), np.tile([1.0, 0.0, 0.0], (len(at), 1))])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    steps, chosen = np.unique(
        np.rint(np.concatenate([ground, rails, plates]) / step_m).astype(np.int64), axis=0, return_index=True
    )
    a, b = packed_normals(normals[chosen])
    return MapPoints(step_m, steps, {"normal_a": a, "normal_b": b})
