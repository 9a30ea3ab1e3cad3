"""The messages of other programs: Foxglove's in protobuf, ROS 2's in CDR. Bytes only: no files, no network.

A cloud says here what `Frame.cloud` says, point for point and in its order; nothing is turned, thinned or rounded.
"""
