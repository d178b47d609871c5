"""A minimal node around the core: joint_states in, joint_velocity_commands out (ROS 2).

It answers one state and exits. With --spin it answers every state, and walks with the integrator:

    dqwalk config paper > paper.yaml
    ros2 run dqwalk_ros integrator --ros-args --params-file paper.yaml
    python examples/ros_node.py --spin

The package's own controller node does much more.
"""

import signal
import sys

import numpy as np
import rclpy
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import JointState

from dqwalk_ros import load, load_model, make_controller
from dqwalk_ros.paper.state import State


class Walker(Node):
    """The paper's controller on two topics."""

    def __init__(self) -> None:
        super().__init__("walker")
        self.config = load("paper")
        self.model = load_model(self.config.robot)
        self.controller = make_controller(self.config, self.model)
        self.commands = self.create_publisher(JointState, "joint_velocity_commands", 1)
        self.create_subscription(JointState, "joint_states", self.on_state, 1)

    def on_state(self, msg: JointState) -> JointState:
        """Answer a state with joint velocities."""
        angles = dict(zip(msg.name, msg.position, strict=True))
        q = np.array([angles[name] for name in self.model.joint_names])
        time = msg.header.stamp.sec + 1e-9 * msg.header.stamp.nanosec
        command = self.controller.step(State(time, q), self.config.dt)
        answer = JointState(header=msg.header, name=list(self.model.joint_names))
        answer.velocity = command.velocity.tolist()
        self.commands.publish(answer)
        return answer


rclpy.init(signal_handler_options=SignalHandlerOptions.NO)  # rclpy's would end the context in the middle of an answer
node = Walker()
if "--spin" in sys.argv[1:]:
    interrupts: list[int] = []
    signal.signal(signal.SIGINT, lambda number, _: interrupts.append(number))
    while not interrupts:
        rclpy.spin_once(node, timeout_sec=0.1)
else:
    state = JointState(name=list(node.model.joint_names), position=[0.0] * node.model.n)
    answer = node.on_state(state)
    print("first command:", np.round(answer.velocity, 4))
node.destroy_node()
rclpy.try_shutdown()
