"""Settings of the streams that fuzzers damage, by name and by the kind of message that they make."""

from __future__ import annotations

from typing import Any

from lidarcodec.codecs import table

Named = dict[str, dict[str, Any]]

PLAIN: Named = {name: {"codec": name} for name in table.names()}
"""Each codec as it is by default."""

MORE: Named = {
    "zstd bounded": {"codec": "zstd", "max_error_m": 0.05, "intensity": "off"},
    "pcodec 1 cm": {"codec": "pcodec", "max_error_m": 0.01, "intensity": "levels=16"},
    "png bounded": {"codec": "png", "max_error_m": 20.0, "intensity": "levels=2"},
    "jxl effort 3": {"codec": "jxl", "codec_settings": {"effort": 3}, "intensity": "levels=256"},
    "riddle effort 1": {"codec": "riddle", "codec_settings": {"effort": 1}, "intensity": "levels=3"},
    "riddle effort 4": {"codec": "riddle", "codec_settings": {"effort": 4}, "intensity": "off"},
    "predictive quick motion": {"codec": "predictive", "codec_settings": {"motion": True}},
    "predictive motion": {"codec": "predictive", "codec_settings": {"motion": True, "effort": 2}},
}
"""Other settings, each of which another part of a message follows."""

FEW: Named = {
    "zstd levels": {"codec": "zstd", "intensity": "levels=5"},
    "zstd error": {"codec": "zstd", "intensity": "error=9"},
    "pcodec levels": {"codec": "pcodec", "intensity": "levels=2"},
    "png error": {"codec": "png", "intensity": "error=127"},
    "predictive error": {"codec": "predictive", "intensity": "error=1"},
}
"""Few values of intensity, grouped (form 2) and modelled (form 5)."""

FREE: Named = {
    "riddle free": {"codec": "riddle", "max_error_m": 0.05, "intensity": "error=6"},
    "riddle free effort 1": {"codec": "riddle", "max_error_m": 0.1, "codec_settings": {"effort": 1}},
    "riddle free effort 3": {"codec": "riddle", "max_error_m": 0.02, "codec_settings": {"effort": 3}},
    "riddle free alone": {"codec": "riddle", "max_error_m": 0.25, "codec_settings": {"memory": False}},
    "predictive free": {"codec": "predictive", "max_error_m": 0.05, "intensity": "levels=128"},
    "predictive free motion": {
        "codec": "predictive",
        "max_error_m": 1.0,
        "codec_settings": {"motion": True, "effort": 2},
    },
    "predictive free quick motion": {"codec": "predictive", "max_error_m": 0.01, "codec_settings": {"motion": True}},
}
"""Ranges that are free within a bound: whole frames and slabs, quick ones, with and without something expected."""

ROUNDED: Named = {
    "riddle rounded": {"codec": "riddle", "max_error_m": 0.05, "shape": "rounded", "intensity": "levels=8"},
    "predictive rounded": {"codec": "predictive", "max_error_m": 0.3, "shape": "rounded", "intensity": "off"},
}
"""The same codecs with ranges on a grid."""

REDUCED: Named = {
    "raw columns": {"codec": "raw", "reduction": "columns:4"},
    "zstd random": {"codec": "zstd", "reduction": "random", "keep_fraction": 0.1},
    "pcodec voxel": {"codec": "pcodec", "reduction": "voxel", "keep_fraction": 0.3},
    "png random": {"codec": "png", "reduction": "random", "keep_fraction": 0.5},
    "jxl columns": {"codec": "jxl", "reduction": "columns:2"},
    "jpeg columns": {"codec": "jpeg", "reduction": "columns:3"},
    "jpeg-layered random": {"codec": "jpeg-layered", "reduction": "random", "keep_fraction": 0.4},
    "h264 columns": {"codec": "h264", "reduction": "columns:2"},
    "h264-log voxel": {"codec": "h264-log", "reduction": "voxel", "keep_fraction": 0.5},
    "riddle columns": {"codec": "riddle", "reduction": "columns:4"},
    "predictive random": {"codec": "predictive", "reduction": "random", "keep_points": 60},
}
"""Fewer returns, in frames of all columns."""

THINNED: Named = {
    "raw lattice": {"codec": "raw", "reduction": "lattice:3"},
    "zstd lattice": {"codec": "zstd", "reduction": "lattice:2", "intensity": "levels=4"},
    "pcodec lattice": {"codec": "pcodec", "reduction": "lattice:4", "max_error_m": 0.1},
    "png lattice": {"codec": "png", "reduction": "lattice:3"},
    "jxl lattice": {"codec": "jxl", "reduction": "lattice:2"},
    "jpeg lattice": {"codec": "jpeg", "reduction": "lattice:2"},
    "jpeg-layered lattice": {"codec": "jpeg-layered", "reduction": "lattice:3"},
    "h264 lattice": {"codec": "h264", "reduction": "lattice:2"},
    "h264-log lattice": {"codec": "h264-log", "reduction": "lattice:5"},
    "riddle lattice": {"codec": "riddle", "reduction": "lattice:2"},
    "riddle free lattice": {"codec": "riddle", "reduction": "lattice:3", "max_error_m": 0.05, "intensity": "error=9"},
    "predictive free lattice": {"codec": "predictive", "reduction": "lattice:4", "max_error_m": 0.1},
}
"""Frames of fewer columns, each message with a LATTICE section."""

AIMED: Named = {
    f"{codec} {purpose}": {"codec": codec, "target_kbps": target, "purpose": purpose}
    for codec, purpose, target in (
        ("riddle", "look", 600.0),
        ("predictive", "detect", 1000.0),
        ("pcodec", "localise", 500.0),
        ("zstd", "archive", 4000.0),
    )
}
"""A target bitrate, which chooses bound, intensities and what is left out by its purpose."""

WEIGHTS: Named = {
    "riddle own weights": {"codec": "riddle"},
    "riddle updates": {"codec": "riddle"},
    "riddle free own weights": {"codec": "riddle", "max_error_m": 0.05},
    "riddle free updates": {"codec": "riddle", "max_error_m": 0.05},
}
"""Streams that bring networks of their own."""

OTHER_PLAIN: Named = {name: {"codec": name} for name in ("raw", "zstd", "pcodec", "predictive", "riddle")}
"""The codecs that take other sensors than the HDL-64E, and point clouds, each as it is by default."""

OTHERS: Named = {
    **OTHER_PLAIN,
    "riddle alone": {"codec": "riddle", "codec_settings": {"memory": False}},
    "zstd bounded": {"codec": "zstd", "max_error_m": 0.05, "intensity": "off"},
    "pcodec levels": {"codec": "pcodec", "intensity": "levels=16"},
    "predictive bounded": {"codec": "predictive", "max_error_m": 0.3, "intensity": "levels=8"},
    "riddle bounded": {"codec": "riddle", "max_error_m": 0.05, "intensity": "error=6"},
    "riddle widest bound": {"codec": "riddle", "max_error_m": 20.0, "intensity": "levels=2"},
    "raw lattice": {"codec": "raw", "reduction": "lattice:3", "intensity": "error=9"},
    "predictive lattice": {"codec": "predictive", "reduction": "lattice:2"},
    "riddle lattice": {"codec": "riddle", "reduction": "lattice:2", "max_error_m": 0.1},
    "zstd columns": {"codec": "zstd", "reduction": "columns:2"},
    "riddle random": {"codec": "riddle", "reduction": "random", "keep_fraction": 0.4},
    "riddle look": {"codec": "riddle", "target_kbps": 60.0, "purpose": "look"},
    "predictive detect": {"codec": "predictive", "target_kbps": 100.0, "purpose": "detect"},
    "zstd archive": {"codec": "zstd", "target_kbps": 400.0, "purpose": "archive"},
}
"""Other settings of these codecs, each of which another part of a message follows."""

OTHER_PICTURES: tuple[dict[str, Any], ...] = (
    {"codec": "png"},
    {"codec": "jxl"},
    {"codec": "png", "max_error_m": 0.05, "reduction": "lattice:2"},
    {"codec": "jxl", "max_error_m": 0.3, "intensity": "levels=8"},
    {"codec": "jpeg", "codec_settings": {"mapping": "log"}},
    {"codec": "jpeg-layered", "codec_settings": {"group": 2, "bits": 8}},
    {"codec": "h264", "reduction": "lattice:2"},
    {"codec": "h264-log", "codec_settings": {"mapping": "paper", "bits": 8}},
)
"""Pictures of other sensors, for the harness of the native session."""

CLOUDS: Named = {
    **OTHER_PLAIN,
    "zstd bounded": {"codec": "zstd", "max_error_m": 0.02},
    "riddle bounded": {"codec": "riddle", "max_error_m": 0.5},
}
"""Streams of point clouds."""
