"""Tu 2016's second measure: how far decoded clouds move a car's estimated place, against the bitrate.

The error is the distance between where the decoded cloud and the original cloud are found, in the map of the originals:
what the codec did, not what the localiser does anyway. Over a codec's settings it falls as the bitrate rises, and where
it crosses 5 cm is one number for the codec (Tu 2016: 1.5 Mbit/s with MPEG video, by NDT).

>>> crossing([(500, 0.2), (1000, 0.1), (2000, 0.025)])
{'kbps': 1414.2, 'is': 'at'}
>>> crossing([(500, 0.02), (1000, 0.01)])
{'kbps': 500, 'is': 'below'}
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, Final

import numpy as np

from lidarcodec.evaluation.localisation.errors import pose_errors, standard_error
from lidarcodec.evaluation.localisation.evaluate import Outcome
from lidarcodec.evaluation.localisation.protocol import COUNTED

AIM_M: Final = 0.05
Result = dict[str, Any]


def against_original(outcome: Outcome, original: Outcome, seed: int) -> Result:
    """`rmse_m`, `mean_m` with its standard error, `of` and `bad` by protocol: estimates beside those of the original
    cloud, with the same map, receiver, localiser and starts. A scan whose original was not found counts for neither;
    one that only the decoded cloud did not find is `bad`, and not in the means."""
    found: Result = {}
    for protocol, estimates in outcome.estimates.items():
        apart = pose_errors(estimates, original.estimates[protocol])
        metres, degrees = COUNTED[protocol]
        sound = (original.errors[protocol]["trans_m"] <= metres) & (original.errors[protocol]["angle_deg"] <= degrees)
        good = sound & (apart["trans_m"] <= metres) & (apart["angle_deg"] <= degrees)
        values = apart["trans_m"][good]
        found[protocol] = {
            "of": int(np.count_nonzero(sound)),
            "bad": int(np.count_nonzero(sound & ~good)),
            "rmse_m": float(np.sqrt(np.mean(values**2))) if len(values) else None,
            "mean_m": float(values.mean()) if len(values) else None,
            "mean_m_error": standard_error(values, seed),
        }
    return found


def crossing(points: Sequence[tuple[float, float]], aim_m: float = AIM_M) -> Result | None:
    """The bitrate from which on the error is at most 5 cm, between two settings along a line on logarithmic scales.

    points: kbit/s and metres of each setting. `below`: already the coarsest is good enough. None: not even the finest.
    """
    ordered = sorted(points)
    worse = [at for at, (_, error) in enumerate(ordered) if error > aim_m]
    if not worse:
        return {"kbps": ordered[0][0], "is": "below"} if ordered else None
    if worse[-1] == len(ordered) - 1:
        return None
    (low, bad), (high, good) = ordered[worse[-1]], ordered[worse[-1] + 1]
    part = math.log(bad / aim_m) / math.log(bad / max(good, 1e-6))
    return {"kbps": round(low * (high / low) ** part, 1), "is": "at"}


def crossings(results: Sequence[Result], protocol: str) -> list[Result]:
    """For each source, codec, reduction, receiver and localiser: where the RMSE crosses 5 cm."""
    groups: dict[tuple[str, ...], list[Result]] = {}
    for result in results:
        name = tuple(result[key] for key in ("source", "codec", "reduction", "receiver", "localiser"))
        groups.setdefault(name, []).append(result)
    found = []
    for (source, codec, reduction, receiver, localiser), group in groups.items():
        points = [(one["kbps"], one["against_original"][protocol]["rmse_m"]) for one in group]
        at = crossing([(kbps, error) for kbps, error in points if error is not None])
        found.append(
            {"source": source, "codec": codec, "reduction": reduction, "receiver": receiver, "localiser": localiser,
             "at_5_cm": at}
        )  # fmt: skip
    return found
