"""Simulated drives of sensors beside the HDL-64E: `sim:city?sensor=os1-128`. docs/simulator.md describes them.

A sensor is one entry in `table.py`: what its detector can do. Layouts, angles and firing times are those of
`lidarcodec.sensors.models`; `blocks.py` and `ouster.py` write what else its packets hold.
"""
