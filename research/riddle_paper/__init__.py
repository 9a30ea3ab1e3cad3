"""RIDDLE as its paper has it, to be compared with: X. Zhou, C. R. Qi, Y. Zhou, D. Anguelov, "RIDDLE: Lidar Data
Compression with Range Image Deep Delta Encoding", CVPR 2022, arXiv 2206.01738.

A range image is quantised; each return is predicted from those before it in raster order, and in the temporal variant
from the scan before; the differences are entropy coded. `images` is the quantised image, `context` what the network
sees, `net` the network, `baselines` what it is held against, `residuals` the two coders, `coding` the
whole way there and back, `run` the training, `measure` the figures of docs/riddle-paper.md, which also says where this
had to fill in what we could not read.

Floats decide what is predicted, so that a decoder needs the encoder's machine and torch: reason enough for the codecs
of this package to count in integers.
"""
