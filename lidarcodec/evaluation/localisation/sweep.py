"""Tu 2016's second measure: how much decoded clouds change the estimated position, against the bitrate.

The error is the distance between the estimates from the decoded and from the original cloud, in the map of the original
clouds. So it contains only the effect of the codec, not the error of the localiser. It falls as the bitrate rises. The
bitrate at which it is 5 cm is one number for a codec (Tu 2016: 1.5 Mbit/s with MPEG video, by NDT).

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
    """`rmse_m`, `mean_m` with its standard error, `of` and `bad` by protocol: differences from the estimates with the
    original cloud and the same map, receiver, localiser and starts. Scans that fail with the original cloud are not
    counted. Scans that fail only with the decoded cloud are `bad`, and not in the means."""
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


def crossing(points: Sequence[tuple[float, float]]) -> Result | None:
    """The smallest bitrate with an error of at most 5 cm, by linear interpolation on logarithmic scales.

    points: kbit/s and metres of each setting. `below`: even the coarsest setting is good enough. None: not even the
    finest one is.
    """
    ordered = sorted(points)
    worse = [at for at, (_, error) in enumerate(ordered) if error > AIM_M]
    if not worse:
        return {"kbps": ordered[0][0], "is": "below"} if ordered else None
    if worse[-1] == len(ordered) - 1:
        return None
    (low, bad), (high, good) = ordered[worse[-1]], ordered[worse[-1] + 1]
    part = math.log(bad / AIM_M) / math.log(bad / max(good, 1e-6))
    return {"kbps": round(low * (high / low) ** part, 1), "is": "at"}


def crossings(results: Sequence[Result], protocol: str) -> list[Result]:
    """The bitrate at which the RMSE is 5 cm, for each source, codec, reduction, receiver and localiser."""
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
