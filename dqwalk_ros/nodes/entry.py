"""Command line of the nodes: what ``--help`` teaches, and the console scripts.

Nothing here needs ROS, so that help and clear errors are there without it.
"""

from __future__ import annotations

import argparse
import importlib
import sys
import textwrap
from collections.abc import Sequence
from dataclasses import dataclass

from dqwalk_ros.config import Config

__all__ = [
    "HELP",
    "controller",
    "integrator",
    "parse",
    "phase_monitor",
    "physics",
    "pilot",
    "poppy_driver",
    "recorder",
    "rigid",
    "viewer",
    "whole_body_controller",
]


@dataclass(frozen=True)
class Help:
    """What a person who meets a node for the first time wants to know."""

    what: str
    gets: tuple[str, ...]
    gives: tuple[str, ...]
    sections: tuple[str, ...]
    example: str


HELP = {
    "controller": Help(
        what="Walk: answer each measured state with joint velocities, from one quadratic program per tick.",
        gets=(
            "joint_states             sensor_msgs/JointState [rad, rad/s], joints matched by name",
            "imu                      sensor_msgs/Imu with plant.imu: roll and pitch, and angular velocity",
            "cmd_vel                  geometry_msgs/Twist, standing walk with gait.steps: 0: linear x, y, angular z",
        ),
        gives=(
            "joint_velocity_commands  sensor_msgs/JointState [rad/s]; stamp: that of the state it answers;",
            "                         with an imu also torques that hold the robot [N m]",
            "phase, support_foot      std_msgs/String, latched; at the end 'finished' or 'failed'",
            "phase_start              sensor_msgs/JointState, latched: the posture in which the phase began",
            "com_target, swing_target geometry_msgs/PointStamped, PoseStamped, latched, in the support sole's frame",
            "base_pose                geometry_msgs/PoseStamped: the pelvis in odom (and /tf where tf2_msgs exists)",
            "walk_config              std_msgs/String, latched: all parameters in force",
            "walk_origin              std_msgs/String, latched: versions and machine",
            "robot_description        std_msgs/String, latched: URDF",
            "/diagnostics             diagnostic_msgs/DiagnosticArray",
            "~/start ~/pause ~/reset  std_srvs/Trigger services",
            "~/stop                   std_srvs/Trigger: a standing walk puts its feet together and is over",
        ),
        sections=(
            *("dt", "robot", "gait", "task", "dsp", "ssp", "standing", "pelvis", "joints", "qp", "plant", "monitor"),
            "node",
        ),
        example="-p gait.step_length:=0.04",
    ),
    "integrator": Help(
        what="Stand in for the robot: integrate the commanded joint velocities (Euler), at 1/dt or in lockstep.",
        gets=("joint_velocity_commands  sensor_msgs/JointState [rad/s]",),
        gives=(
            "joint_states             sensor_msgs/JointState [rad, rad/s]",
            "/diagnostics             diagnostic_msgs/DiagnosticArray",
        ),
        sections=("dt", "robot", "plant", "node"),
        example="-p plant.lockstep:=true",
    ),
    "physics": Help(
        what="Stand in for the robot: MuJoCo, true soles, servos, an inertial sensor; real time or lockstep.",
        gets=(
            "joint_velocity_commands  sensor_msgs/JointState [rad/s]; its efforts are fed forward [N m]",
            "push                     geometry_msgs/WrenchStamped: its force times 1 s hits the pelvis [N s], in world",
        ),
        gives=(
            "joint_states             sensor_msgs/JointState [rad, rad/s]",
            "imu                      sensor_msgs/Imu of the link physics.imu, the same stamp as the state's",
            "true_base_pose           geometry_msgs/PoseStamped: the pelvis in the world; for analysis, as the rest:",
            "left_foot_wrench, right_foot_wrench   geometry_msgs/WrenchStamped: ground on the sole, in its frame",
            "center_of_pressure       geometry_msgs/PointStamped: of both feet in the world; none in the air",
            "/diagnostics             diagnostic_msgs/DiagnosticArray: ERROR when the robot has fallen",
            "~/reset                  std_srvs/Trigger: puts the robot back on its feet (real time)",
        ),
        sections=("dt", "robot", "plant", "physics", "servo", "node"),
        example="-p plant.imu:=true",
    ),
    "poppy_driver": Help(
        what="Drive a real Poppy Humanoid through pypot; poppy.dummy:=true tries it without one.",
        gets=("joint_velocity_commands  sensor_msgs/JointState [rad/s]",),
        gives=(
            "joint_states             sensor_msgs/JointState of all 25 motors, once the first pose is reached",
            "joint_goals              sensor_msgs/JointState: the angles they were told with that state [rad]",
            "/diagnostics             temperature, voltage and load of every motor",
            "~/compliant              std_srvs/SetBool: true switches the torque off, false on again",
        ),
        sections=("dt", "robot", "plant", "poppy"),
        example="-p dt:=0.02 -p poppy.dummy:=true",
    ),
    "phase_monitor": Help(
        what="Watch a walk from outside: every distance, error and margin, recomputed from the topics alone.",
        gets=(
            "joint_states, phase, phase_start, swing_target, walk_config   as the controller publishes them;",
            "                         the parameters of the walk come from walk_config, not from this node's own",
        ),
        gives=(
            "/diagnostics             diagnostic_msgs/DiagnosticArray: OK, WARN or ERROR by the smallest distance",
            "com                      geometry_msgs/PointStamped, in the phase's base sole",
            "support_polygon          geometry_msgs/PolygonStamped",
            "walk_markers             visualization_msgs/MarkerArray: planes, cylinder, CoM, soles (RViz, Foxglove)",
        ),
        sections=("monitor",),
        example="-p monitor.rate:=20.0",
    ),
    "pilot": Help(
        what="Steer a standing walk along a course: velocities on cmd_vel, one after the other, then ~/stop.",
        gets=("joint_states             sensor_msgs/JointState: the walk's own time, in which the course is measured",),
        gives=("cmd_vel                  geometry_msgs/Twist, ten times a second",),
        sections=("gait", "node"),
        example="--cmd-vel 0.015,0,0,20 --cmd-vel 0,0,0.03,20",
    ),
    "recorder": Help(
        what="Record a walk as a rosbag2 (MCAP), byte for byte; report how much came and whether anything is missing.",
        gets=(
            "every topic of the walk: joint_states, joint_velocity_commands, phase, phase_start, com_target,",
            "swing_target, support_foot, base_pose, walk_config, walk_origin, robot_description, /diagnostics;",
            "those of the node physics where it runs; of the whole body: joint_effort_commands, base_twist,",
            "left_wrench, right_wrench, hand_target_applied, push_applied",
        ),
        gives=("the folder --bag: an .mcap file and metadata.yaml, for ros2 bag, Foxglove and `dqwalk report`",),
        sections=("plant",),
        example="--bag my_walk",
    ),
    "whole_body_controller": Help(
        what="Walk where the hand wants to go, and keep able to stop: answer each state with joint torques.",
        gets=(
            "joint_states, base_pose, base_twist   one state in three messages with one stamp [rad, rad/s, m, m/s]:",
            "                         sensor_msgs/JointState; geometry_msgs/PoseStamped of the root link in odom;",
            "                         geometry_msgs/TwistStamped of it in its own axes",
            "hand_target              geometry_msgs/PoseStamped: where the hand should be in odom; move it at any time",
        ),
        gives=(
            "joint_effort_commands    sensor_msgs/JointState [N m]; stamp: that of the state it answers",
            "hand_target_applied      geometry_msgs/PoseStamped, latched; stamp: the first state that it holds for",
            "walk_config              std_msgs/String, latched: all parameters in force",
            "walk_origin              std_msgs/String, latched: versions and machine",
            "robot_description        std_msgs/String, latched: URDF",
            "/diagnostics             diagnostic_msgs/DiagnosticArray: WARN where it cannot stop within the preview",
        ),
        sections=("dt", "robot", "gait", "whole_body"),
        example="-p whole_body.friction:=0.4",
    ),
    "rigid": Help(
        what="Stand in for the robot of the whole-body controller: rigid bodies on rigid ground.",
        gets=(
            "joint_effort_commands    sensor_msgs/JointState [N m]",
            "push                     geometry_msgs/WrenchStamped: its force times 1 s hits the torso [N s], in odom",
        ),
        gives=(
            "joint_states, base_pose, base_twist   one state in three messages with one stamp, from 0 s on",
            "left_wrench, right_wrench  geometry_msgs/WrenchStamped: ground on a sole that stands, about its origin",
            "push_applied             geometry_msgs/WrenchStamped, latched; stamp: the first state after it",
            "/diagnostics             diagnostic_msgs/DiagnosticArray",
        ),
        sections=("dt", "robot", "plant", "whole_body"),
        example="-p plant.lockstep:=true",
    ),
    "viewer": Help(
        what="Show the walk in the browser while it goes on: robot, constraints, margins (needs viser).",
        gets=(
            "joint_states, phase, phase_start, com_target, swing_target, walk_config, robot_description, /diagnostics;",
            "base_pose once           geometry_msgs/PoseStamped: where in odom the first phase seen stands",
        ),
        gives=("nothing on ROS: a page on 127.0.0.1, whose address is logged; the walk never waits for it",),
        sections=(),
        example="--port 8090",
    ),
}


def parse(name: str, argv: Sequence[str]) -> argparse.Namespace:
    """Read the command line of a node; ``.argv`` is all of it, for rclpy.

    Parameters
    ----------
    name : str
        Which node.
    argv : sequence of str
        Without the program's name.
    """
    parser = argparse.ArgumentParser(
        prog=name,
        usage=f"{name} {'--bag DIR ' if name == 'recorder' else ''}[--ros-args --params-file FILE -p NAME:=VALUE ...]",
        description=HELP[name].what,
        epilog=_epilog(name),
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument(
        "--child", action="store_true", help="for programs: print progress as lines of JSON, end with the parent"
    )
    if name == "recorder":
        parser.add_argument("--bag", metavar="DIR", required=True, help="the folder to make; it must not be there yet")
    if name == "pilot":
        parser.add_argument(
            "--cmd-vel", metavar="X,Y,TURN,S", action="append", required=True,
            help="walk so [m/s, m/s, rad/s] for so long [s]; several are walked in order",
        )  # fmt: skip
    if name == "viewer":
        parser.add_argument("--port", type=int, help="port of the page; 0: any [8080, or the next free one]")
    own = list(argv)
    if "--ros-args" in own:
        start = own.index("--ros-args")
        stop = own.index("--", start) + 1 if "--" in own[start:] else len(own)
        del own[start:stop]
    options = parser.parse_args(own)
    options.argv = [name, *argv]
    return options


def _epilog(name: str) -> str:
    about = HELP[name]
    lines = [
        "subscribes to:",
        *(f"  {line}" for line in about.gets),
        "",
        {"recorder": "writes:", "viewer": "serves:"}.get(name, "publishes:"),
    ]
    lines += [f"  {line}" for line in about.gives]
    lines += ["", "parameters (name = default [unit]):"]
    for spec in Config.specs():
        if spec.name.split(".")[0] in about.sections:
            unit = f" [{spec.unit}]" if spec.unit else ""
            value = str(spec.default).lower() if spec.type is bool else spec.default
            head = f"  {spec.name} = {value if value not in ('', ()) else '(none)'}{unit}"
            lines += textwrap.wrap(spec.meaning, 118, initial_indent=f"{head:42s}  ", subsequent_indent=" " * 44)
    lines += [
        "",
        "  Every node takes every parameter of the package, so that one file serves all (`/**:`); a name that does not",
        "  exist is an error. Exit code: 0 stopped or finished, 1 the walk failed, 2 arguments that cannot be used.",
        "",
        "example:",
        f"  dqwalk_{name} {about.example if about.example.startswith('--') else ''}".rstrip()
        + f" --ros-args --params-file config/{_config(name)}.yaml"
        + (f" {about.example}" if not about.example.startswith("--") else ""),
        f"  ros2 run dqwalk_ros {name} --help",
    ]
    return "\n".join(lines)


def _config(name: str) -> str:
    """Return the configuration that fits a node."""
    if name in ("physics", "pilot"):
        return "poppy"
    return "whole_body" if "whole_body" in HELP[name].sections else "paper"


def _run(name: str) -> int:
    """Run a node as a console script."""
    parse(name, sys.argv[1:])  # help and wrong options need no ROS
    try:
        module = importlib.import_module(f"dqwalk_ros.nodes.{name}")
    except ModuleNotFoundError as error:
        if (error.name or "").split(".")[0] == "dqwalk_ros":
            raise
        if error.name == "pinocchio":
            print(f"{name}: needs pinocchio: pip install 'dqwalk_ros[wholebody]'", file=sys.stderr)
            return 2
        if error.name == "mujoco":
            print(f"{name}: needs MuJoCo: pip install 'dqwalk_ros[sim]'", file=sys.stderr)
            return 2
        if error.name == "viser":
            print("viewer: the page needs viser: pip install 'dqwalk_ros[view]'", file=sys.stderr)
            return 2
        print(
            f"{name}: ROS 2 is not there (no Python module '{error.name}'): source a ROS 2 Jazzy setup file, or "
            "install the wheels with: pip install 'dqwalk_ros[ros]'",
            file=sys.stderr,
        )
        return 2
    code: int = module.main()
    return code


def controller() -> int:
    """Console script ``dqwalk_controller``."""
    return _run("controller")


def integrator() -> int:
    """Console script ``dqwalk_integrator``."""
    return _run("integrator")


def phase_monitor() -> int:
    """Console script ``dqwalk_phase_monitor``."""
    return _run("phase_monitor")


def physics() -> int:
    """Console script ``dqwalk_physics``."""
    return _run("physics")


def pilot() -> int:
    """Console script ``dqwalk_pilot``."""
    return _run("pilot")


def poppy_driver() -> int:
    """Console script ``dqwalk_poppy_driver``."""
    return _run("poppy_driver")


def recorder() -> int:
    """Console script ``dqwalk_recorder``."""
    return _run("recorder")


def whole_body_controller() -> int:
    """Console script ``dqwalk_whole_body_controller``."""
    return _run("whole_body_controller")


def rigid() -> int:
    """Console script ``dqwalk_rigid``."""
    return _run("rigid")


def viewer() -> int:
    """Console script ``dqwalk_viewer``."""
    return _run("viewer")
