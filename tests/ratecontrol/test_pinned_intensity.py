"""What an operator says of intensities is kept, whatever the target."""

from __future__ import annotations

from itertools import islice

import numpy as np
import pytest

from lidarcodec import api
from lidarcodec.pipeline import StreamDecoder, StreamEncoder
from lidarcodec.settings import StreamSettings
from tests.sweeps import sampled


@pytest.mark.parametrize("intensity", sampled(["error=4", "levels=5", "lossless", "off"], ["levels=5", "lossless"]))
def test_a_target_leaves_a_pinned_intensity_as_it_is(intensity: str) -> None:
    settings = StreamSettings(codec="pcodec", target_kbps=1500, intensity=intensity, framing="revolution")
    encoder, decoder, seen = StreamEncoder(settings), StreamDecoder(), 0
    for frame in islice(api.read_frames("sim:city?seed=5&frames=6", framing="revolution"), 1, 5):
        for message in encoder.encode(frame):
            for came in decoder.decode(message):
                sent = came.valid & frame.valid
                seen += int(np.count_nonzero(sent))
                values = came.intensity[sent].astype(int)
                off = np.abs(values - frame.intensity[sent])
                assert off.max(initial=0) <= {"error=4": 4, "lossless": 0}.get(intensity, 255)
                assert len(np.unique(values)) <= {"levels=5": 5, "off": 1}.get(intensity, 256)
    assert seen
    assert encoder.rate is not None
    assert encoder.rate["intensity"] == intensity
