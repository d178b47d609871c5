"""The robot in the physics engine Drake, to check that a walk does not depend on the engine it was developed in.

Drake solves contact, position servos and joint friction together, implicitly (SAP). Soles touch the floor at points: at
their corners, on a level floor.
"""

from __future__ import annotations

import logging
import math
from typing import Any
from xml.etree import ElementTree

import numpy as np
from numpy.typing import ArrayLike
from pydrake.common.value import Value
from pydrake.geometry import (
    AddContactMaterial,
    Box,
    CollisionFilterDeclaration,
    GeometrySet,
    HalfSpace,
    ProximityProperties,
    Sphere,
)
from pydrake.math import RigidTransform, RollPitchYaw, RotationMatrix
from pydrake.multibody.math import SpatialForce
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import (
    AddMultibodyPlantSceneGraph,
    CoulombFriction,
    DiscreteContactApproximation,
    ExternallyAppliedSpatialForce,
)
from pydrake.multibody.tree import PdControllerGains
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder

from dqwalk_ros.paper.dual_quaternions import DQ
from dqwalk_ros.paper.foot import Foot
from dqwalk_ros.plants.engine import HELD, EnginePlant, floor_of, gravity_of, pose_of, steps_of
from dqwalk_ros.robot.servos import Servos
from dqwalk_ros.support.arrays import Array
from dqwalk_ros.support.errors import PlantError

logging.getLogger("drake").setLevel(logging.ERROR)  # it warns that half spaces have no contact with what is soft

_STIFFNESS = 3e5
"""Stiffness of the contact at a corner where ``physics.contact_stiffness`` is 0 [N/m], near that of MuJoCo."""
_RADIUS = 1e-4
"""Radius of the points of contact [m]."""
_SPACING = 0.012
"""Largest distance between the points of a sole on rubble and stairs [m]."""
_SLIDING = 1e-3
"""Velocity above which dry friction of a joint is constant [rad/s]."""


class DrakePlant(EnginePlant):
    """The robot in Drake."""

    def _make(self, servos: Servos) -> None:
        config, model, n = self.config.physics, self.model, self.model.n
        self._step = self.config.dt / steps_of(self.config.dt, config.timestep)
        builder = DiagramBuilder()
        world, scene = self._world, _ = AddMultibodyPlantSceneGraph(builder, self._step)
        world.set_discrete_contact_approximation(DiscreteContactApproximation.kSap)
        world.mutable_gravity_field().set_gravity_vector(gravity_of(self._level))
        try:
            (self._robot,) = Parser(world).AddModelsFromString(
                _description(model.urdf_without_shapes, model.joint_names, config.mass_scale), "urdf"
            )
        except RuntimeError as error:
            raise PlantError(f"Drake refuses the robot: {error}") from error
        if config.held:
            world.WeldFrames(world.world_frame(), world.GetFrameByName(model.root), RigidTransform([0.0, 0.0, HELD]))
        joints = [world.GetJointByName(name) for name in model.joint_names]
        self._play = 0.5 * servos.stiffness * servos.backlash
        self._stiffness = servos.stiffness
        for k, joint in enumerate(joints):
            joint.set_default_damping(servos.back_emf[k])
            _add_motor(world, joint, servos.torque[k], servos.stiffness[k], servos.damping[k], servos.armature[k])
        self._rubbed = bool(servos.friction.any())
        if self._rubbed:  # -clip(f / v0 dq, -f, f)
            for k, joint in enumerate(joints):
                dry = max(servos.friction[k], 1e-9)
                _add_motor(world, joint, dry, 0.0, dry / _SLIDING, servos.armature[k])
        points = self._add_contacts()
        scene.collision_filter_manager().Apply(CollisionFilterDeclaration().ExcludeWithin(GeometrySet(points)))
        world.Finalize()
        self._qs = np.array([joint.position_start() for joint in joints])
        self._vs = np.array([joint.velocity_start() for joint in joints])
        diagram = builder.Build()
        self._simulator = Simulator(diagram)
        self._context = world.GetMyMutableContextFromRoot(self._simulator.get_mutable_context())
        self._steps = 0
        self._wanted = np.zeros((4 if self._rubbed else 2) * n)
        self._extra = np.zeros((2 if self._rubbed else 1) * n)
        links = (model.root, model.pelvis, model.imu_link, *(model.soles[foot].frame for foot in Foot))
        self._bodies = {link: world.GetBodyByName(link) for link in links}
        self._desired = world.get_desired_state_input_port(self._robot)
        self._desired.FixValue(self._context, self._wanted)
        world.get_actuation_input_port(self._robot).FixValue(self._context, self._extra)
        self._force = world.get_applied_spatial_force_input_port()

    def _add_contacts(self) -> list[Any]:
        """Add the floor, and points of contact to the soles, which are returned.

        Their damping is 2 contact_time times their stiffness, as that of MuJoCo is.
        """
        config, model, world = self.config.physics, self.model, self._world
        height, boxes = floor_of(self.config)
        stiffness = config.contact_stiffness or _STIFFNESS

        def material(share: float) -> Any:
            out = ProximityProperties()
            # two bodies in contact are springs in series, and their relaxation times are added
            friction = CoulombFriction(config.friction, config.friction)
            AddContactMaterial(point_stiffness=2.0 * share * stiffness, friction=friction, properties=out)
            out.AddProperty("material", "relaxation_time", config.contact_time)
            return out

        points: list[Any] = []
        for foot in Foot:
            sole = model.soles[foot]
            nx, ny = (math.ceil(size / _SPACING) + 1 if boxes else 2 for size in (sole.length, sole.width))
            body, properties = world.GetBodyByName(sole.frame), material(4.0 / (nx * ny))
            for x in np.linspace(-0.5, 0.5, nx) * sole.length:
                for y in np.linspace(-0.5, 0.5, ny) * sole.width:
                    at = RigidTransform([sole.center[0] + x, sole.center[1] + y, _RADIUS])
                    name = f"{foot.value} {len(points)}"
                    points.append(world.RegisterCollisionGeometry(body, at, Sphere(_RADIUS), name, properties))
        # the same material as that of the points, so that each contact has the stiffness of its point
        floor = material(4.0 / (len(points) / 2))
        for i, box in enumerate(boxes):
            at = RigidTransform(RollPitchYaw(0.0, 0.0, box.turn), box.at)
            world.RegisterCollisionGeometry(world.world_body(), at, Box(*(2.0 * np.array(box.half))), f"box {i}", floor)
        # last: Drake 1.51 ends the process while it sorts hundreds of boxes beside a shape of infinite size
        world.RegisterCollisionGeometry(
            world.world_body(), RigidTransform([0.0, 0.0, height]), HalfSpace(), "floor", floor
        )
        return points

    def _seat(self, q: Array, root: Array | None) -> None:
        world, context = self._world, self._context
        x = world.GetPositions(context)
        x[self._qs] = q
        world.SetPositions(context, x)
        if root is not None:
            pose = RigidTransform(RotationMatrix(DQ(root).rotation_matrix()), DQ(root).translation())
            world.SetFreeBodyPose(context, self._bodies[self.model.root], pose)

    def _divide(self, dt: float) -> int:
        count = round(dt / self._step)
        if count < 1 or abs(count * self._step - dt) > 1e-9:
            raise PlantError(f"the period of {dt:g} s is no multiple of Drake's step of {self._step:g} s")
        return count

    @property
    def _time(self) -> float:
        return self._steps * self._step

    def _run(self, goals: Array, steps: int) -> Array:
        n, world, context = self.model.n, self._world, self._context
        self._wanted[:n] = goals
        self._desired.FixValue(context, self._wanted)
        torque, played = np.zeros(n), self._play.any()
        net = world.get_net_actuation_output_port(self._robot)
        try:
            for _ in range(steps):
                if played:
                    # zero torque within the backlash b: K (e - clip(e, -b/2, b/2))
                    error = goals - world.GetPositions(context)[self._qs]
                    self._extra[:n] = -np.clip(self._stiffness * error, -self._play, self._play)
                    world.get_actuation_input_port(self._robot).FixValue(context, self._extra)
                self._steps += 1
                # Drake steps at the multiples of the step; half a step after one no rounding of times matters
                self._simulator.AdvanceTo((self._steps - 0.5) * self._step)
                torque += net.Eval(context)[:n]  # of this step, and so are contacts and accelerations
        except RuntimeError as error:
            raise PlantError(f"the simulation cannot go on: {str(error)[:200]}") from error
        return torque

    def push(self, force: ArrayLike, link: str = "") -> None:
        """Push a link; see `Plant.push`."""
        body, acting = self._world.GetBodyByName(link or self.model.pelvis), ExternallyAppliedSpatialForce()
        acting.body_index = body.index()
        acting.p_BoBq_B = body.CalcCenterOfMassInBodyFrame(self._context)
        acting.F_Bq_W = SpatialForce(np.zeros(3), np.asarray(force, dtype=np.float64))
        self._force.FixValue(self._context, Value[list[ExternallyAppliedSpatialForce]]([acting]))

    def _joints(self) -> tuple[Array, Array]:
        world, context = self._world, self._context
        return world.GetPositions(context)[self._qs], world.GetVelocities(context)[self._vs]

    def _imu_motion(self) -> tuple[Array, Array, Array]:
        body = self._bodies[self.model.imu_link]
        rotation = self._world.EvalBodyPoseInWorld(self._context, body).rotation()
        velocity = self._world.EvalBodySpatialVelocityInWorld(self._context, body).rotational()
        return rotation.ToQuaternion().wxyz(), velocity, np.ascontiguousarray(rotation.matrix())

    def _acceleration(self) -> Array:
        world, body = self._world, self._bodies[self.model.imu_link]
        rotation = world.EvalBodyPoseInWorld(self._context, body).rotation().matrix()
        accelerations = world.get_body_spatial_accelerations_output_port().Eval(self._context)
        moving = accelerations[body.index()].translational()
        felt: Array = (moving - gravity_of(self._level)) @ rotation
        return felt

    def _pose(self, link: str) -> Array:
        pose = self._world.EvalBodyPoseInWorld(self._context, self._bodies[link])
        x: Array = pose_of(np.array(pose.translation()), pose.rotation().ToQuaternion().wxyz())
        return x

    def _height_of(self, link: str) -> float:
        return float(self._world.EvalBodyPoseInWorld(self._context, self._bodies[link]).translation()[2])

    def _wrench(self, foot: Foot) -> Array:
        world, body = self._world, self._bodies[self.model.soles[foot].frame]
        pose, index, out = world.EvalBodyPoseInWorld(self._context, body), body.index(), np.zeros(6)
        results = world.get_contact_results_output_port().Eval(self._context)
        for i in range(results.num_point_pair_contacts()):
            contact = results.point_pair_contact_info(i)
            if index in (contact.bodyA_index(), contact.bodyB_index()):
                force = contact.contact_force() if contact.bodyB_index() == index else -contact.contact_force()
                out[:3] += force
                out[3:] += np.cross(contact.contact_point() - pose.translation(), force)
        wrench: Array = (out.reshape(2, 3) @ pose.rotation().matrix()).ravel()
        return wrench

    @property
    def _com(self) -> Array:
        com: Array = self._world.CalcCenterOfMassPositionInWorld(self._context, [self._robot])
        return com

    def _floor_normal(self) -> Array:
        pose = self._world.EvalBodyPoseInWorld(self._context, self._bodies[self.model.pelvis])
        normal: Array = pose.rotation().matrix()[2].copy()
        return normal


def _description(urdf: str, joints: tuple[str, ...], scale: float) -> str:
    """Return a robot description with scaled masses, whose named joints have no limits, friction or damping."""
    robot = ElementTree.fromstring(urdf)
    for inertial in robot.iter("inertial"):
        for value in (*inertial.findall("mass"), *inertial.findall("inertia")):
            value.attrib.update({key: repr(scale * float(number)) for key, number in value.attrib.items()})
    for joint in robot.findall("joint"):
        if joint.get("name") in joints:
            joint.set("type", "continuous")
            for part in ("limit", "dynamics", "safety_controller", "mimic"):
                for found in joint.findall(part):
                    joint.remove(found)
    for transmission in robot.findall("transmission"):
        robot.remove(transmission)
    return ElementTree.tostring(robot, encoding="unicode")


def _add_motor(world: Any, joint: Any, limit: float, stiffness: float, damping: float, armature: float) -> None:
    """Add the torque clip(stiffness e - damping dq + extra, -limit, limit) to a joint.

    Drake gives a joint the reflected inertia of its last motor; it does not add them up.
    """
    motor = world.AddJointActuator(f"motor {world.num_actuators()}", joint, float(limit))
    motor.set_default_rotor_inertia(float(armature))
    motor.set_default_gear_ratio(1.0)
    motor.set_controller_gains(PdControllerGains(p=float(stiffness), d=float(damping)))
