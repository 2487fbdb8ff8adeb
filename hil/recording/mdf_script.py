"""Run by another Python, in an environment with asammdf: columns of numbers into one MF4 file.

    python mdf_script.py COLUMNS.npy DESCRIPTION.json OUT.mf4

Imports nothing of servohil, and servohil never imports it: with asammdf in its environment `import can` loads
pandas and starts threads.
"""

import datetime
import json
import sys

import numpy as np
from asammdf import MDF, Signal


def main(columns: str, description: str, out: str) -> None:
    """One channel group with every signal on the time axis `t_ns`."""
    rows = np.load(columns, mmap_mode="r", allow_pickle=False)
    with open(description, encoding="utf-8") as stream:
        told = json.load(stream)
    time_s = np.asarray(rows["t_ns"]) * 1e-9
    signals = [
        Signal(np.ascontiguousarray(rows[name]), time_s, unit=unit, name=name, comment=meaning)
        for name, unit, meaning in told["signals"]
    ]
    with MDF(version="4.10") as mdf:
        mdf.append(signals, comment=told["comment"], common_timebase=True)
        mdf.header.comment = told["comment"]
        # 1970 where the clock was simulated: the moment of the export would mislead
        mdf.header.start_time = datetime.datetime.fromtimestamp(told["origin_ns"] * 1e-9, datetime.UTC)
        mdf.save(out, overwrite=False, compression=1)


if __name__ == "__main__":
    main(*sys.argv[1:4])
