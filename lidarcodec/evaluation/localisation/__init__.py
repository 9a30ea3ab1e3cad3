"""Localisation with decoded frames: the protocol of the PocoNet paper, and the second measure of Tu 2016."""
