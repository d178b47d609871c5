"""Commanded footsteps: a path of sole poses sets the next steps of a walk, or is refused with the reason.

Path and status are topics instead of an action, because Jazzy has no action for footsteps, and a new one would need an
interface package, which pip cannot install.
"""

from __future__ import annotations

from nav_msgs.msg import Path
from std_msgs.msg import String

from dqwalk_ros.controller import VelocityController
from dqwalk_ros.nodes import messages as ros
from dqwalk_ros.nodes.base import WalkNode
from dqwalk_ros.nodes.odometry import Odometry
from dqwalk_ros.paper.dual_quaternions import DQ
from dqwalk_ros.paper.foot import Foot
from dqwalk_ros.paper.phase import PhaseKind
from dqwalk_ros.support.arrays import Array
from dqwalk_ros.support.errors import StateError
from dqwalk_ros.support.wording import shown
from dqwalk_ros.walks.stepping import SteppingWalk

_MAX_STEPS = 50
"""Most footsteps in one path: to check one takes some hundredths of a second."""


class FootstepInput:
    """Input of the topic footsteps (nav_msgs/Path): sole poses to step on, feet alternating; an empty path cancels.

    The frame of the path is odom or a sole link, which is then the first support foot. A path is accepted in a stance
    only. What a landing has missed is made up for by the next one.

    Parameters
    ----------
    controller : VelocityController
        Of a standing or dynamic walk with gait.steps: 0.
    """

    def __init__(self, node: WalkNode, controller: VelocityController, odometry: Odometry) -> None:
        self._node, self._controller, self._odometry = node, controller, odometry
        self._total = 0
        self._status = node.create_publisher(String, "footstep_status", ros.latched())
        node.create_subscription(Path, "footsteps", self._on_path, 1)

    def _on_path(self, msg: Path) -> None:
        walk = self._controller.walk
        if not isinstance(walk, SteppingWalk):
            self._publish_status("refused: only a standing or dynamic walk (gait.style) supports footsteps")
        elif not msg.poses:
            left, self._total = walk.placed, 0
            walk.place(Foot.LEFT, [])
            self._publish_status(f"cancelled: {left} footsteps dropped, the feet are put together")
        else:
            try:
                support, steps = self._steps(msg)
                walk.place(support, steps)
            except StateError as error:
                self._publish_status(f"refused: {error}")
                return
            self._total = len(steps)
            self._publish_status(f"walking 0/{self._total}")

    def _steps(self, msg: Path) -> tuple[Foot, list[Array]]:
        """Return the first support foot and the poses (8,) of the footprints, each relative to the one before."""
        controller, feet = self._controller, self._controller.model.foot_of
        if controller.phase_index < 0 or controller.phase.kind is not PhaseKind.STANCE:
            raise StateError("the robot is not in a stance; an empty path cancels the current footsteps")
        if len(msg.poses) > _MAX_STEPS:
            raise StateError(f"{len(msg.poses)} footsteps; {_MAX_STEPS} at most in one path")
        soles, origin = controller.soles(), DQ(self._odometry.origin)
        wanted = []
        for k, one in enumerate(msg.poses, start=1):
            if (frame := one.header.frame_id) not in ("", msg.header.frame_id):
                where = shown(msg.header.frame_id)
                raise StateError(f"footstep {k} is in the frame '{shown(frame)}', the path in '{where}'")
            wanted.append(ros.checked_pose(one, f"footstep {k}"))
        if (given := msg.header.frame_id) in feet:
            support = feet[given]
            before = DQ(1.0)
        elif given in ("", self._node.config.odometry.odom_frame):
            here = {foot: origin * DQ(soles[foot]) for foot in Foot}
            support = min(Foot, key=lambda foot: self._side_error(foot, here[foot].conj() * wanted[0]))
            before = here[support]
        else:
            raise StateError(
                f"the path is in the frame '{shown(given)}'; it must be odom, or a sole: {', '.join(feet)}"
            )
        steps = []
        for x in wanted:
            steps.append((before.conj() * x).vec8())
            before = x
        return support, steps

    def _side_error(self, support: Foot, x: DQ) -> float:
        """Return the lateral distance [m] of a footprint, given in the sole of `support`, from a step in place."""
        walk = self._controller.walk
        assert isinstance(walk, SteppingWalk)
        return abs(float((x.translation() - DQ(walk.footsteps.beside(support)).translation())[1]))

    def show(self, ended: str = "") -> None:
        """Publish the number of footsteps done; called when a phase begins, and when a walk has `ended`, for what."""
        walk, phase = self._controller.walk, self._controller.phase
        if not self._total or not isinstance(walk, SteppingWalk):
            return
        # a step that recovers from a push, maybe before the first footstep, is none of them
        total, done = self._total, max(walk.taken - (phase.kind is PhaseKind.SINGLE_SUPPORT), 0)
        dropped = total - done if ended else total - walk.taken - walk.placed
        if dropped:
            self._total = 0
            self._publish_status(f"cancelled: {dropped} footsteps dropped, {ended or 'the feet are put together'}")
        elif phase.kind is PhaseKind.STANCE and done == total:
            self._total = 0
            self._publish_status(f"done {done}/{done}")
        else:
            self._publish_status(f"walking {done}/{total}")

    def _publish_status(self, text: str) -> None:
        self._node.get_logger().info(f"footsteps: {text}")
        self._status.publish(String(data=text))
