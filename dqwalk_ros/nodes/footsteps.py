"""Commanded footsteps: a path of soles becomes the next steps of a standing walk, or is refused with the limit.

A path and a status are topics, not an action: Jazzy has no message for footsteps, and an action of our own would need a
package of interfaces, which pip cannot install.
"""

from __future__ import annotations

import math

import numpy as np
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Path
from numpy.typing import NDArray
from std_msgs.msg import String

from dqwalk_ros.controller import VelocityController
from dqwalk_ros.dual_quaternions import DQ
from dqwalk_ros.errors import StateError
from dqwalk_ros.nodes import messages as ros
from dqwalk_ros.nodes.base import WalkNode
from dqwalk_ros.nodes.odometry import Odometry
from dqwalk_ros.robot import Foot
from dqwalk_ros.standing.walk import StandingWalk
from dqwalk_ros.walk import PhaseKind

__all__ = ["FootstepInput"]

Array = NDArray[np.float64]

_MOST = 50
"""Footsteps in one path: each takes some hundredths of a second to look at."""


class FootstepInput:
    """footsteps (nav_msgs/Path): poses of soles to step on, the feet in turn; an empty path cancels what is left.

    The path is in odom, or in a sole link, which then is the foot that stands first. It is taken in a stance. Each
    footstep is walked relative to the one before: what a landing is off is not made up for.

    Parameters
    ----------
    node : WalkNode
    controller : VelocityController
        Of a standing walk without a number of steps.
    odometry : Odometry
    """

    def __init__(self, node: WalkNode, controller: VelocityController, odometry: Odometry) -> None:
        self._node, self._controller, self._odometry = node, controller, odometry
        self._total = 0
        self._status = node.create_publisher(String, "footstep_status", ros.latched())
        node.create_subscription(Path, "footsteps", self._on_path, ros.stream(1))

    def _on_path(self, msg: Path) -> None:
        walk = self._controller.walk
        if not isinstance(walk, StandingWalk):  # a walk of your own
            self._say("refused: this walk takes no footsteps")
        elif not msg.poses:
            left, self._total = walk.placed, 0
            walk.place(Foot.LEFT, [])
            self._say(f"cancelled: {left} footsteps are left out, the feet are put together")
        else:
            try:
                support, steps = self._steps(msg)
                walk.place(support, steps)
            except StateError as error:
                self._say(f"refused: {error}")
                return
            self._total = len(steps)
            self._say(f"walking 0/{self._total}")

    def _steps(self, msg: Path) -> tuple[Foot, list[Array]]:
        """Return the foot that stands first and the footprints (8,), each in the one before."""
        controller, model = self._controller, self._controller.model
        if controller.phase_index < 0 or controller.phase.kind is not PhaseKind.STANCE:
            raise StateError("the robot is not in a stance; an empty path cancels footsteps under way")
        if len(msg.poses) > _MOST:
            raise StateError(f"{len(msg.poses)} footsteps; {_MOST} at most in one path")
        soles, origin = controller.soles(), DQ(self._odometry.origin)
        wanted = []
        for k, one in enumerate(msg.poses, start=1):
            if (frame := one.header.frame_id) not in ("", msg.header.frame_id):
                raise StateError(f"footstep {k} is in the frame '{frame}', the path in '{msg.header.frame_id}'")
            wanted.append(_footprint(one, k))
        frames = {model.soles[foot].frame: foot for foot in Foot}
        if (given := msg.header.frame_id) in frames:
            support = frames[given]
            before = DQ(1.0)
        elif given in ("", self._node.config.odometry.odom_frame):
            here = {foot: origin * DQ(soles[foot]) for foot in Foot}
            support = min(Foot, key=lambda foot: self._off(foot, here[foot].conj() * wanted[0]))
            before = here[support]
        else:
            raise StateError(f"the path is in the frame '{given}'; it must be odom, or a sole: {', '.join(frames)}")
        steps = []
        for x in wanted:
            steps.append((before.conj() * x).vec8())
            before = x
        return support, steps

    def _off(self, support: Foot, x: DQ) -> float:
        """Return how far a footprint in the sole of `support` is from beside it, to the side [m]."""
        walk = self._controller.walk
        assert isinstance(walk, StandingWalk)
        return abs(float((x.translation() - DQ(walk.footsteps.beside(support)).translation())[1]))

    def show(self) -> None:
        """Publish how far the robot has come, at the beginning of a phase."""
        walk, phase = self._controller.walk, self._controller.phase
        if not self._total or not isinstance(walk, StandingWalk):
            return
        done = self._total - walk.placed - (phase.kind is PhaseKind.SINGLE_SUPPORT)
        if phase.kind is PhaseKind.STANCE and done == self._total:
            self._total = 0
            self._say(f"done {done}/{done}")
        else:
            self._say(f"walking {done}/{self._total}")

    def _say(self, text: str) -> None:
        self._node.get_logger().info(f"footsteps: {text}")
        self._status.publish(String(data=text))


def _footprint(msg: PoseStamped, number: int) -> DQ:
    p, r = msg.pose.position, msg.pose.orientation
    size = math.sqrt(r.w**2 + r.x**2 + r.y**2 + r.z**2)
    if not (abs(size - 1.0) < 1e-3 and all(map(math.isfinite, (p.x, p.y, p.z)))):
        raise StateError(f"footstep {number} has no unit quaternion (its norm is {size:g}), or no finite position")
    return DQ.from_pose([p.x, p.y, p.z], [r.w / size, r.x / size, r.y / size, r.z / size])
