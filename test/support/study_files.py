"""Study files of short walks of the paper."""

from __future__ import annotations

from pathlib import Path

SHORT = (
    "config: paper\n"
    "set: {dt: 0.02, task.eta: 2.0, task.damping: 0.02, ssp.threshold: 0.02, dsp.stall_rate: 0.005, qp.solver: daqp,"
    " gait.phase_timeout: 3.0}\n"
)


def write(path: Path, text: str) -> Path:
    path.write_text(text, encoding="utf-8")
    return path
