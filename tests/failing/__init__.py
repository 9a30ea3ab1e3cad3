"""Failure injection: disk writes, renames and memory fail at the n-th call, for every n, in the programs themselves.

The idea is SQLite's. A process that has imported everything makes a child for each n, so that thousands are affordable.

    python -m tests.failing                    every n of every row (`make faults`)
    python -m tests.failing "encode" --kind disk
"""
