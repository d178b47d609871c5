"""The plant that stands in for the hardware: it integrates the commanded velocities."""

from __future__ import annotations

import sys

from dqwalk_ros.config import Config
from dqwalk_ros.model import RobotModel
from dqwalk_ros.nodes import entry
from dqwalk_ros.nodes.runtime import run
from dqwalk_ros.nodes.simulated import SimulatedPlant
from dqwalk_ros.plants import Plant
from dqwalk_ros.plants.kinematic import KinematicPlant

__all__ = ["IntegratorNode", "main"]


class IntegratorNode(SimulatedPlant):
    """joint_velocity_commands -> joint_states, joints that move exactly as they are told."""

    def make_plant(self, config: Config, model: RobotModel) -> Plant:
        """Return the integrator."""
        return KinematicPlant(model, compiled=False)  # the node is spared numba


def main(argv: list[str] | None = None) -> int:
    """Run the node; return the exit code."""
    options = entry.parse("integrator", sys.argv[1:] if argv is None else argv)
    return run("integrator", lambda node, life: IntegratorNode(node, life, options), options)


if __name__ == "__main__":
    sys.exit(main())
