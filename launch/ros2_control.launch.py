"""Starts Poppy with ros2_control: controller_manager, broadcasters and a forward controller; then walk.launch.py.

ros2 launch dqwalk_ros ros2_control.launch.py interface:=velocity
ros2 launch dqwalk_ros ros2_control.launch.py plugin:=mujoco_ros2_control/MujocoSystemInterface mujoco_model:=poppy.xml

For a robot whose controllers are running already, walk.launch.py plant:=ros2_control is sufficient.
"""

from launch import LaunchDescription
from launch.actions import RegisterEventHandler
from launch.event_handlers import OnProcessExit
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterFile

from dqwalk_ros.config import find_config, find_share
from dqwalk_ros.nodes.launching import description, included
from dqwalk_ros.robot.xacro_file import expanded

PLUGINS = [
    "mock_components/GenericSystem",
    "mujoco_ros2_control/MujocoSystemInterface",
    "gz_ros2_control/GazeboSimSystem",
    "joint_state_topic_hardware_interface/JointStateTopicSystem",
]
ARGUMENTS = {
    "plugin": (PLUGINS[0], "hardware component of ros2_control: mock joints, MuJoCo, Gazebo, or a plant behind "
               "topics; the plugin of another robot has a name like these", None),
    "mujoco_model": ("", "model file (MJCF), for mujoco_ros2_control only", None),
    "interface": ("position", "command interface of the joints", ["position", "velocity"]),
    "controllers": (str(find_share("config/ros2_control", "controllers.yaml")), "parameter file of the controllers",
                    None),
    "walk": ("true", "also start the walk; false: only the robot", ["true", "false"]),
    "config": ("poppy", "parameter file of the walk, or the name of a shipped one", None),
    "params": ("", "further parameter file of the walk, applied after those of config and plant", None),
    "set": ("", "single parameters of the walk, applied last: 'KEY=VALUE KEY=VALUE'", None),
    "namespace": ("", "namespace of all nodes and topics of this robot", None),
    "use_sim_time": ("false", "use the time of /clock, as with Gazebo", ["true", "false"]),
}  # fmt: skip


def nodes(given: dict[str, str]) -> list[object]:
    space, time = given["namespace"], {"use_sim_time": given["use_sim_time"] == "true"}
    arguments = {name: given[name] for name in ("plugin", "mujoco_model")}
    urdf = expanded(find_share("urdf", "poppy.ros2_control.urdf.xacro"), arguments=arguments).text
    package = given["plugin"].partition("/")[0]
    # mujoco_ros2_control and Gazebo have their own controller manager
    manager = {"mujoco_ros2_control": "mujoco_ros2_control", "gz_ros2_control": ""}.get(package, "controller_manager")
    forward = f"forward_{given['interface']}_controller"

    def node(package: str, executable: str, **options: object) -> Node:
        enclave = ["--enclave", f"/dqwalk/{options.get('name', executable)}"]
        return Node(
            package=package, executable=executable, namespace=space, output="screen", ros_arguments=enclave,
            remappings=[("/tf", "tf"), ("/tf_static", "tf_static")] if space else [], **options,
        )  # fmt: skip

    publisher = node("robot_state_publisher", "robot_state_publisher",
                     parameters=[{"robot_description": urdf.decode()}, time])  # fmt: skip
    spawner = node(
        "controller_manager", "spawner", name="spawner",
        arguments=["joint_state_broadcaster", "imu_sensor_broadcaster", forward, "--controller-manager",
                   "controller_manager", "--param-file", given["controllers"]],
        parameters=[time],
    )  # fmt: skip
    started: list[object] = [publisher, spawner]
    if manager:
        file = ParameterFile(given["controllers"])
        started.append(node(manager, "ros2_control_node", parameters=[file, time]))
    if given["walk"] == "true":
        values = {"plant": "ros2_control", "interface": given["interface"], "namespace": space,
                  "config": str(find_config(given["config"])), "params": given["params"], "set": given["set"],
                  "use_sim_time": given["use_sim_time"]}  # fmt: skip
        walk = included("walk", {name: value for name, value in values.items() if value})
        started.append(RegisterEventHandler(OnProcessExit(target_action=spawner, on_exit=[walk])))
    return started


def generate_launch_description() -> LaunchDescription:
    return description(ARGUMENTS, nodes)
