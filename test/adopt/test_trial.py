"""What is said of the walk that tries a new configuration."""

from __future__ import annotations

from dqwalk_ros.adopt.trial import Trial
from dqwalk_ros.report.binding import Load


def test_a_trial_says_what_was_walked_and_what_its_report_finds() -> None:
    loads = Load(1e-3, "l_knee", 1.0), Load(0.731, "l_knee", 1.0)
    for trial, expected in (
        (Trial("physics", True, 0.59, 0.6, ""), "physics: walked 0.590 m"),
        (Trial("physics", True, 0.2, 0.6, ""), "physics: walked 0.200 m instead of 0.600 m"),
        (Trial("physics", True, 0.6, 0.6, "a sole"), "physics: walked 0.600 m, but a sole"),
        (Trial("physics", True, 0.6, 0.6, "", touching="shins"), "physics: walked 0.600 m, but shins"),
        (Trial("physics", True, 0.6, 0.6, "", load=loads[0]), "physics: walked 0.600 m"),
        (
            Trial("physics", True, 0.6, 0.6, "", load=loads[1]),
            "physics: walked 0.600 m, l_knee needs 73 % of its torque-speed curve at 1.00 s",
        ),
    ):
        assert str(trial) == expected
