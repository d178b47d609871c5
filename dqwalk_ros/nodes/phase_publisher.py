"""The phases of a walk, published by the controller at their start; `phase_log` rebuilds them."""

from __future__ import annotations

from rclpy.publisher import Publisher
from std_msgs.msg import String

from dqwalk_ros.config import to_yaml
from dqwalk_ros.controller import VelocityController
from dqwalk_ros.nodes import messages as ros
from dqwalk_ros.nodes.base import WalkNode
from dqwalk_ros.paper.kinematics import Kinematics
from dqwalk_ros.paper.phase import Phase
from dqwalk_ros.paper.walk import com_target
from dqwalk_ros.robot.model import RobotModel


class PhasePublisher:
    """Publishes the start of each phase, and on `configurations` changed parameters, for `PhaseLog`."""

    def __init__(self, node: WalkNode, model: RobotModel, configurations: Publisher) -> None:
        self._model, self._logger, self._config = model, node.get_logger(), node.config
        self._configurations = configurations
        self.restart()
        names = ("phase", "phase_log", "phase_start", "support_foot", "swing_target", "com_target")
        self._pub = {name: node.advertise(name) for name in names}

    def show(self, text: str) -> None:
        """Publish the name of the current phase or mode, such as ``double_support/left`` or ``idle``."""
        self._pub["phase"].publish(String(data=text))
        self._pub["phase_log"].publish(String(data=text))

    def restart(self) -> None:
        """Forget the phases of the last walk."""
        self._index = self._began = -1
        self._decision = ""

    def follow(self, controller: VelocityController, stamp: int) -> bool:
        """Publish what has changed at the state with a stamp [ns]; return whether a phase has begun."""
        phase, before, self._decision = controller.phase, self._decision, controller.phase.decision
        if controller.phase_index != self._index:
            self._index, self._began = controller.phase_index, stamp
            if controller.config is not self._config:
                self._config = controller.config
                self._configurations.publish(String(data=to_yaml(controller.config, stamp)))
            self._begin(phase)
            return True
        if phase.decision != before:  # the target of the swing foot, for the reason given
            self._publish_target(phase)
            self.show(phase.decision)
            self._logger.info(phase.decision)
        return False

    def _begin(self, phase: Phase) -> None:
        """Publish a phase, with the stamp of its first state; seconds as a float would not be exact."""
        model, frame = self._model, self._model.soles[phase.base].frame
        start = ros.JointWriter(model.joint_names, frame)(self._began, position=phase.q_start)
        self._pub["phase_start"].publish(start)
        self._pub["support_foot"].publish(String(data=phase.support.value))
        if phase.swing_target is None:
            goal = com_target(phase.kind, Kinematics(model, phase.q_start, phase.base))
            self._pub["com_target"].publish(ros.point(self._began, frame, goal))
        self._publish_target(phase)
        self.show(phase.name)

    def _publish_target(self, phase: Phase) -> None:
        if phase.swing_target is not None:
            frame = self._model.soles[phase.base].frame
            self._pub["swing_target"].publish(ros.pose(self._began, frame, phase.swing_target))
