"""Studies: many walks with varied parameters.

`runner` runs the walks on one machine or on a Dask cluster, saves each outcome, and resumes an interrupted study. A
study from a file is a `Study` (`plan`) of walks (`walks`); `robustness`, `pushes` and
`evidence` are studies in physics.
"""

from __future__ import annotations

from dqwalk_ros.studies.plan import Study, read
from dqwalk_ros.studies.walks import set_up, walk, walk_all

__all__ = ["Study", "read", "set_up", "walk", "walk_all"]
