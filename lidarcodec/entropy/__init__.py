"""Entropy coding: adaptive binary range coder; the coders of mask, azimuth, range, intensity and side information."""

from lidarcodec.entropy.azimuth_coder import columns_in_turn, decode_azimuth, encode_azimuth
from lidarcodec.entropy.fast import GivenLayer, NativeNets, net_forms
from lidarcodec.entropy.intensity_coder import IntensityMemory, choose_levels, decode_intensity, encode_intensity
from lidarcodec.entropy.keep_coder import decode_keep, encode_keep
from lidarcodec.entropy.mask_coder import decode_mask, encode_mask
from lidarcodec.entropy.mask_stream import STREAM_KINDS, MaskStream
from lidarcodec.entropy.net_trainer import NetTrainer, ReturnSamples, TrainSettings
from lidarcodec.entropy.position_coder import decode_positions, encode_positions
from lidarcodec.entropy.predictive_coder import KnownColumns, PredictiveCoder, known_columns
from lidarcodec.entropy.side_coder import decode_side, encode_side

__all__ = [
    "GivenLayer",
    "IntensityMemory",
    "STREAM_KINDS",
    "KnownColumns",
    "MaskStream",
    "NativeNets",
    "NetTrainer",
    "PredictiveCoder",
    "ReturnSamples",
    "TrainSettings",
    "columns_in_turn",
    "decode_azimuth",
    "choose_levels",
    "decode_intensity",
    "decode_keep",
    "decode_mask",
    "decode_positions",
    "decode_side",
    "encode_azimuth",
    "encode_intensity",
    "encode_keep",
    "encode_mask",
    "encode_positions",
    "encode_side",
    "known_columns",
    "net_forms",
]
