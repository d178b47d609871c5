"""Shows a running walk in the browser.

The node only subscribes: for each frame it takes the newest state and rebuilds the phase from the topics. No other node
waits for it.
"""

from __future__ import annotations

import argparse
import contextlib
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped, Twist, TwistStamped, WrenchStamped
from sensor_msgs.msg import JointState

from dqwalk_ros.nodes import messages as ros
from dqwalk_ros.nodes.base import WalkNode, throttled
from dqwalk_ros.nodes.phase_log import PhaseLog
from dqwalk_ros.paper.dual_quaternions import DQ
from dqwalk_ros.paper.kinematics import Kinematics, compose
from dqwalk_ros.paper.phase import Phase
from dqwalk_ros.report.scene import Moment, Scene
from dqwalk_ros.report.viewer.page import FRAME, Page
from dqwalk_ros.robot.model import RobotModel
from dqwalk_ros.support.arrays import Array
from dqwalk_ros.support.errors import DqwalkError, StateError
from dqwalk_ros.walks.course import speeds
from dqwalk_ros.walks.table import walk_type

_STEER = 0.1
"""Period of the velocities that a steered walk receives [s]."""
_PUSH = 0.1
"""Default impulse of the push buttons, per mass of the robot [m/s]."""


class Viewer(WalkNode):
    """Show a running walk in the browser: robot, constraints, margins (needs viser).

    The pose of the walk in odom follows from the phases: each begins where the one before has placed its foot. For a
    walk whose first phases were missed, the first pose is taken from one message of `base_pose`.

    Subscribes to::

        joint_states, imu, phase, phase_start, com_target, swing_target, walk_config, robot_description, /diagnostics;
        true_base_pose           geometry_msgs/PoseStamped: published by a simulated robot, which can be pushed
        base_pose, one message   geometry_msgs/PoseStamped: pose in odom of the first phase received

    Publishes, if the robot is simulated and a push button of the page is pressed::

        push                     geometry_msgs/WrenchStamped: its force times 1 s is the impulse [N s]
        cmd_vel                  geometry_msgs/Twist, or TwistStamped with node.stamped_cmd_vel: until "stop", or until
                                 no browser shows the page, of a steered walk

    Serves::

        a page on 127.0.0.1, whose address is logged; the walk does not wait for it

    Sections of the schema: node.stamped_cmd_vel.

    Example::

        dqwalk_viewer --port 8090 --ros-args --params-file config/paper.yaml

    Raises
    ------
    ViewerError
        If the port of the page is in use.
    """

    has_diagnostics = False

    def __init__(self, options: argparse.Namespace, **keywords: Any) -> None:
        super().__init__("viewer", options, **keywords)
        self.page = Page(options.port)
        self._phases = PhaseLog(self)
        self._shown: RobotModel | None = None
        self._phase: Phase | None = None
        self._index = -1
        self._began = -1  # [ns]
        self._origin = 0  # zero of the time shown: start of the first phase received [ns]
        self._x_odom_base = DQ(1.0).vec8()
        self._state: JointState | None = None  # to be shown next
        self._states: dict[int, Array] = {}  # pelvis poses by stamp [ns], until base_pose is received
        self._solver = ""
        self._impulse = 0.0  # default of the push buttons [N s]
        self._push = self.create_publisher(WrenchStamped, "push", 10)
        self._twist_type = TwistStamped if self.config.node.stamped_cmd_vel else Twist
        self._twists = self.create_publisher(self._twist_type, "cmd_vel", 1)
        self._velocity = np.zeros(3)  # chosen on the page: ahead, left [m/s], turn [rad/s]
        self._steered = self._velocity  # published last
        self.create_subscription(PoseStamped, "true_base_pose", self._on_simulated, ros.best_effort(1))
        self.listen(JointState, "joint_states", self._on_state, ros.best_effort(1))
        self.listen(DiagnosticArray, "/diagnostics", self._on_diagnostics, 10)
        self._odometry: Any = self.create_subscription(PoseStamped, "base_pose", self._on_pose, 1)
        self.create_timer(FRAME, self._show)
        self.create_timer(_STEER, self._steer)
        self.get_logger().info(f"the page is {self.page.url}")

    # ------------------------------------------------------------------ configuration and phases

    def _load(self) -> bool:
        """Show the robot of the topics; return whether it is known."""
        config, model = self._phases.config, self._phases.model
        if config is None or model is None:
            return False
        if model is not self._shown:
            try:
                self.page.set_scene(Scene(config, model))
            except DqwalkError as error:
                self.get_logger().error(str(error), **throttled())
                return False
            self._impulse = round(_PUSH * model.mass, 2)
            self._shown = model
            self._restart()
        return True

    def _restart(self) -> None:
        self._phase, self._index, self._began = None, -1, -1
        self._x_odom_base = DQ(1.0).vec8()

    def _follow(self, stamp: int) -> bool:
        """Advance to the phase at a state's stamp [ns], through all phases before it; return whether it is known."""
        match self._phases.register(stamp):
            case "wrong":
                return False
            case "set back":
                self._restart()
        for began in self._phases.begun(self._began, stamp):
            found = self._phases.at(began)
            if found is None:
                return False
            self._enter(began, found[1].model, found[1].phase)
        return self._phase is not None

    def _enter(self, began: int, model: RobotModel, phase: Phase) -> None:
        self._index += 1
        if self._index == 0:
            self._origin = began
        if self._phase is not None and phase.base is not self._phase.base:
            # the base changes to the other sole, at its pose at the start of this phase
            kin = Kinematics(model, phase.q_start, self._phase.base)
            self._x_odom_base = compose(self._x_odom_base, kin.pose(kin.swing))
        self._phase, self._began, self._states = phase, began, {}

    # ------------------------------------------------------------------ the states

    def _on_state(self, msg: JointState) -> None:
        if not self._phases.is_foreign(msg):
            self._state = msg

    def _on_pose(self, msg: PoseStamped) -> None:
        """Compute the pose in odom of the first phase received from one pelvis pose; then unsubscribe."""
        x = self._states.get(ros.nanoseconds(msg.header.stamp))
        if x is None or self._odometry is None:
            return
        try:
            self._x_odom_base = (ros.checked_pose(msg, "base_pose") * DQ(x).conj()).vec8()
        except StateError as error:
            self.get_logger().error(str(error), **throttled())
            return
        self.destroy_subscription(self._odometry)
        self._odometry, self._states = None, {}

    def _on_simulated(self, msg: PoseStamped) -> None:
        """Offer to push and to steer the robot: only a simulated one has a true pose."""
        config, model = self._phases.config, self._shown
        if config is None or model is None:
            return
        self.page.offer_push(self._on_push, self._impulse)
        if not (kind := walk_type(config)).phases(config) and not self.page.steers:
            self.page.offer_steering(self._on_steer, np.array(speeds(kind(config, model))))

    def _on_steer(self, velocity: Array) -> None:
        """Note the velocity (3,) chosen on the page, which calls from another thread."""
        self._velocity = velocity

    def _steer(self) -> None:
        """Publish the chosen velocity; none at rest, where another node may steer, but at first that it stops."""
        if not self.page.is_watched:
            self._velocity = np.zeros(3)
        moved, self._steered = self._steered, self._velocity
        if moved.any() or self._steered.any():
            msg = self._twist_type()
            twist = msg if isinstance(msg, Twist) else msg.twist
            twist.linear.x, twist.linear.y, twist.angular.z = self._steered.tolist()
            self._twists.publish(msg)

    def _on_push(self, impulse: Array) -> None:
        """Push the robot by an impulse (3,) in the frame of the base sole [N s]; the page calls from another thread."""
        force = DQ(self._x_odom_base).P().Ad(DQ(impulse)).vec3()
        msg = WrenchStamped()
        msg.wrench.force.x, msg.wrench.force.y, msg.wrench.force.z = force.tolist()
        self._push.publish(msg)

    def _on_diagnostics(self, msg: DiagnosticArray) -> None:
        own = f"{self.get_namespace()}/controller:".lstrip("/")
        for status in msg.status:
            if status.name.startswith(own):
                values = {pair.key: pair.value for pair in status.values}
                if "iterations" not in values:
                    self._solver = status.message
                    continue
                with contextlib.suppress(ValueError):  # of a controller that is not ours
                    micro = 1e6 * float(values.get("solve time", "nan"))
                    active = values.get("active rows", "") or "none"
                    self._solver = f"{values['iterations']} iterations, {micro:.0f} µs; active: {active}"

    def _show(self) -> None:
        """Draw the newest state."""
        msg, self._state = self._state, None
        model, reader = self._phases.model, self._phases.reader
        if not self._load() or msg is None or model is None or reader is None:
            return
        stamp = ros.nanoseconds(msg.header.stamp)
        if not self._follow(stamp) or self._phase is None:
            return
        try:
            state = reader.state(msg)
        except StateError as error:
            self.get_logger().error(f"joint_states rejected: {error}", **throttled())
            return
        if self._odometry is not None:
            pelvis = Kinematics(model, state.q, self._phase.base).pose(model.pelvis)
            self._states = {**dict(list(self._states.items())[-50:]), stamp: pelvis}
        self.page.show(
            Moment(
                time=1e-9 * (stamp - self._origin),
                q=state.q,
                phase=self._phase,
                index=self._index,
                began=1e-9 * (self._began - self._origin),
                x_odom_base=self._x_odom_base,
                label=self._phases.label,
                solver=self._solver,
                dq=state.dq,
                up=self._phases.up(stamp),
            )
        )

    def close(self) -> None:
        """Stop the page."""
        self.page.close()
