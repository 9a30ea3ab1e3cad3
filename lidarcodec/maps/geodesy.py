"""Latitude and longitude on WGS 84 to UTM, by the series of Krueger (1912) to the fourth order: right to a millimetre.

>>> east, north, zone, convergence = utm_of(49.0, 8.4)
>>> round(east, 2), round(north, 2), zone, round(convergence, 4)
(456114.6, 5427629.2, 32, -0.4528)
"""

from __future__ import annotations

import math
from typing import Final

RADIUS_M: Final = 6_378_137.0
FLATTENING: Final = 1 / 298.257223563
SCALE: Final = 0.9996


def utm_of(latitude: float, longitude: float) -> tuple[float, float, int, float]:
    """Easting and northing in metres, zone, and the angle from true north to grid north, in degrees clockwise.
    Northings south of the equator have the usual 10,000 km added."""
    zone = min(int((longitude + 180) // 6) + 1, 60)
    n = FLATTENING / (2 - FLATTENING)
    radius = RADIUS_M / (1 + n) * (1 + n**2 / 4 + n**4 / 64)
    alphas = (
        n / 2 - 2 * n**2 / 3 + 5 * n**3 / 16 + 41 * n**4 / 180,
        13 * n**2 / 48 - 3 * n**3 / 5 + 557 * n**4 / 1440,
        61 * n**3 / 240 - 103 * n**4 / 140,
        49561 * n**4 / 161280,
    )
    away = math.radians(longitude - (zone * 6 - 183))
    sine = math.sin(math.radians(latitude))
    root = 2 * math.sqrt(n) / (1 + n)
    t = math.sinh(math.atanh(sine) - root * math.atanh(root * sine))
    xi, eta = math.atan2(t, math.cos(away)), math.atanh(math.sin(away) / math.hypot(1, t))
    east = eta + sum(a * math.cos(2 * j * xi) * math.sinh(2 * j * eta) for j, a in enumerate(alphas, 1))
    north = xi + sum(a * math.sin(2 * j * xi) * math.cosh(2 * j * eta) for j, a in enumerate(alphas, 1))
    convergence = math.degrees(math.atan(math.tan(away) * sine))
    return (
        500_000 + SCALE * radius * east,
        (10_000_000 if latitude < 0 else 0) + SCALE * radius * north,
        zone,
        convergence,
    )


def wkt_of(zone: int, *, south: bool = False) -> str:
    """A zone of UTM as OGC WKT 1, the text that LAS 1.4 has for a coordinate reference system.

    >>> wkt_of(32)[:32], wkt_of(33, south=True)[-26:]
    ('PROJCS["WGS 84 / UTM zone 32N",G', 'AUTHORITY["EPSG","32733"]]')
    """
    degrees = (
        f'GEOGCS["WGS 84",DATUM["WGS_1984",SPHEROID["WGS 84",{RADIUS_M:.0f},{1 / FLATTENING:.9f},'
        'AUTHORITY["EPSG","7030"]],AUTHORITY["EPSG","6326"]],PRIMEM["Greenwich",0,AUTHORITY["EPSG","8901"]],'
        'UNIT["degree",0.0174532925199433,AUTHORITY["EPSG","9122"]],AUTHORITY["EPSG","4326"]]'
    )
    values = {
        "latitude_of_origin": 0,
        "central_meridian": zone * 6 - 183,
        "scale_factor": SCALE,
        "false_easting": 500_000,
        "false_northing": 10_000_000 if south else 0,
    }
    parameters = "".join(f'PARAMETER["{name}",{value}],' for name, value in values.items())
    return (
        f'PROJCS["WGS 84 / UTM zone {zone}{"S" if south else "N"}",{degrees},PROJECTION["Transverse_Mercator"],'
        f'{parameters}UNIT["metre",1,AUTHORITY["EPSG","9001"]],AXIS["Easting",EAST],AXIS["Northing",NORTH],'
        f'AUTHORITY["EPSG","{32_700 + zone if south else 32_600 + zone}"]]'
    )
