"""Another robot: the paper's walk only needs its URDF, pelvis and soles. See also `dqwalk adopt`."""

from dqwalk_ros import Config, KinematicPlant, load_model, make_controller, simulate

config = Config().updated(
    {
        "robot.urdf": "hrp2_like.urdf",  # a path, or a file of the package
        "robot.pelvis": "pelvis",
        "robot.left_sole": "L_sole",
        "robot.right_sole": "R_sole",
        "robot.drop": ["waist_yaw"],  # removed with all links they carry
        "robot.sole_length": 0.24,
        "robot.sole_width": 0.14,
        "pelvis.height": 0.5,
    }
)
model = load_model(config.robot)
trace = simulate(make_controller(config, model), KinematicPlant(model), max_time=1.0)
print(f"{model.name}: {model.n} joints, {model.mass:.1f} kg, {len(trace)} states of {trace.phases[0].name}")
print("; ".join(trace.notes))
