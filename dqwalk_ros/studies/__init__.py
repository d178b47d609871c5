"""Studies: the same walk many times over, with parameters varied.

`Study` says what is varied (`plan`), `walk` walks once (`walks`), `run` walks them all, on one machine or on a Dask
cluster (`scheduling`).
"""

from __future__ import annotations

from dqwalk_ros.studies.plan import Study, read
from dqwalk_ros.studies.scheduling import run
from dqwalk_ros.studies.walks import walk

__all__ = ["Study", "read", "run", "walk"]
