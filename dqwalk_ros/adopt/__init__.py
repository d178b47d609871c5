"""Makes a configuration that walks from another robot's description.

`adoption` reads a URDF or MJCF (`mjcf`), repairs what is in `doubts`, identifies legs, soles, arms and sensors
(`anatomy`), finds a posture (`posture`, `stance`), derives the parameters of the walks (`parameters`) and writes the
`files`; `trial` walks with them. Each value is reported with its source and a confidence.
"""

from __future__ import annotations

from dqwalk_ros.adopt.adoption import Adoption, adopt

__all__ = ["Adoption", "adopt"]
