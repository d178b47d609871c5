"""A fictitious biped, the parameters of its two phases, and states of a walk: the input of `benchmark.tick`.

The robot is a serial chain from the sole of the left foot, up the leg, through the pelvis and down the other leg; the
world is the left sole. Body i is attached to joint i: x_i = x_{i-1} (fixed_R_i, fixed_p_i) rot(axis_i, q_i).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from dqwalk_ros.paper.dual_quaternions import DQ

Array = np.ndarray
PHASES = {"dsp": "double support", "ssp": "single support"}

# hip yaw, roll, pitch, knee, ankle pitch, roll; offset of each joint from the one above it [m]
_LEG = (
    ("z", (0.0, 0.05, -0.02)),
    ("x", (0.0, 0.0, -0.02)),
    ("y", (0.01, 0.0, -0.03)),
    ("y", (0.0, 0.0, -0.18)),
    ("y", (0.0, 0.0, -0.18)),
    ("x", (0.0, 0.0, -0.02)),
)
_SOLE = np.array([0.0, 0.0, -0.03])
_AXIS = {"x": np.array([1.0, 0.0, 0.0]), "y": np.array([0.0, 1.0, 0.0]), "z": np.array([0.0, 0.0, 1.0])}
_PELVIS_MASS, _LINK_MASS = 0.8, 0.08


@dataclass(frozen=True)
class Chain:
    """The robot.

    Attributes
    ----------
    names : list of str
    fixed_R : ndarray, shape (n, 3, 3)
    fixed_p, axis, com : ndarray, shape (n, 3)
        [m], unit vector, [m], in the frame of each body.
    mass : ndarray, shape (n,)
        [kg]
    base_mass, base_com : float and ndarray, shape (3,)
        Of the left foot, which is the base [kg], [m].
    tip_R, tip_p : ndarray
        The right sole in the frame of the last body.
    q_min, q_max : ndarray, shape (n,)
        [rad]
    pelvis_index : int
        The body that carries the pelvis, at `pelvis_point` (3,) of it.
    """

    names: list[str]
    fixed_R: Array
    fixed_p: Array
    axis: Array
    mass: Array
    com: Array
    base_mass: float
    base_com: Array
    tip_R: Array
    tip_p: Array
    q_min: Array
    q_max: Array
    pelvis_index: int
    pelvis_point: Array

    @property
    def n(self) -> int:
        """Number of joints."""
        return len(self.names)


@dataclass
class Walk:
    """The parameters of both phases: section 5 of the paper, and positions in the frame of the left sole.

    A plane is its unit normal n and offset d; the distance n.p - d is kept above zero. Centres are points (3,) on
    upright axes.
    """

    com_target: Array  # (2,) of the double support
    slide_center: Array
    tip_plane: tuple[Array, float]
    back_plane: tuple[Array, float]
    pelvis_height: float
    com_center: Array
    x_goal: Array  # (8,) of the swing foot in single support
    eta: float = 0.05
    lam: float = 0.1
    dt: float = 0.005
    eta_sliding: float = 5.0
    eta_ground: float = 5.0
    eta_pelvis: float = 500.0
    eta_tip: float = 10.0
    eta_back: float = 20.0
    eta_q: float = 10.0
    eta_com: float = 5.0
    slide_radius: float = 0.04
    com_radius: float = 0.05
    q_start: Array = field(default_factory=lambda: np.zeros(0))


def biped() -> Chain:
    """Return a pelvis of 0.8 kg on two legs of six joints."""
    mirrored = np.array([1.0, -1.0, 1.0])
    left = np.cumsum([offset for _, offset in _LEG], axis=0)  # joints, seen from the pelvis, all at zero
    right = mirrored * left
    places = np.concatenate([left[::-1], right])
    axes = np.array([_AXIS[a] for a, _ in _LEG])
    # centre of mass of each body; in the left leg a joint moves the link above it
    links = np.array([0.005, 0.003, -0.05])
    com = np.concatenate([(left + links)[-2::-1], [[0.0, 0.0, 0.05]], right + mirrored * links])
    mass = np.full(12, _LINK_MASS)
    mass[5] = _PELVIS_MASS
    sole = left[-1] + _SOLE
    return Chain(
        names=[f"l_{k}" for k in range(6)][::-1] + [f"r_{k}" for k in range(6)],
        fixed_R=np.broadcast_to(np.eye(3), (12, 3, 3)).copy(),
        fixed_p=np.diff(places, axis=0, prepend=sole[None]),
        axis=np.concatenate([-axes[::-1], axes]),
        mass=mass,
        com=com - places,
        base_mass=_LINK_MASS,
        base_com=left[-1] + links - sole,
        tip_R=np.eye(3),
        tip_p=_SOLE.copy(),
        q_min=np.full(12, -1.6),
        q_max=np.full(12, 1.6),
        pelvis_index=5,
        pelvis_point=-left[0],
    )


def walk_of(chain: Chain) -> Walk:
    """Return the parameters of a step from a crouched posture."""
    bend = {2: -0.35, 3: 0.7, 4: -0.35}
    q = np.array([bend.get(int(name[2:]), 0.0) for name in chain.names])
    pose, p = DQ(1.0), [np.zeros(3)]
    mass, moment, pelvis = chain.base_mass, chain.base_mass * chain.base_com, np.zeros(3)
    for i in range(chain.n):
        turn = DQ(np.concatenate([[np.cos(q[i] / 2)], np.sin(q[i] / 2) * chain.axis[i], np.zeros(4)]))
        pose = pose * DQ.from_matrix(chain.fixed_R[i], chain.fixed_p[i]) * turn
        p.append(pose.translation())
        mass, moment = mass + chain.mass[i], moment + chain.mass[i] * (pose * DQ.from_pose(chain.com[i])).translation()
        if i == chain.pelvis_index:
            pelvis = (pose * DQ.from_pose(chain.pelvis_point)).translation()
    tip, com = pose * DQ.from_matrix(chain.tip_R, chain.tip_p), moment / mass
    x, y, _ = tip.translation()
    ahead = np.array([1.0, 0.0, 0.0])
    return Walk(
        com_target=np.array([0.01, y]),
        slide_center=np.array([x, y, 0.0]),
        tip_plane=(-ahead, -(max(0.0, x, com[0]) + 0.06)),
        back_plane=(ahead, min(0.0, x, com[0]) - 0.035),
        pelvis_height=0.55 * pelvis[2],
        com_center=np.array([com[0], 0.5 * com[1], 0.0]),
        x_goal=(DQ.from_pose([0.05, 0.0, 0.0]) * tip).vec8(),
        q_start=q,
    )


def states(tick: Callable[[Array], Array], walk: Walk, ticks: int = 20_000, blocks: int = 20) -> list[Array]:
    """Return 500 states of a closed loop of Euler steps, in blocks of neighbours."""
    starts = np.linspace(0, ticks - 26, blocks).astype(int)
    kept = {int(start) + k for start in starts for k in range(25)}
    q, out = walk.q_start, []
    for index in range(ticks):
        if index in kept:
            out.append(q)
        q = q + walk.dt * tick(q)
    return out


def chain_urdf(chain: Chain) -> str:
    """Return the chain as URDF text, with links ``base``, ``tip`` and ``pelvis``, rooted at the left sole."""

    def text(values: Array) -> str:
        return " ".join(f"{value:.17g}" for value in values)

    def place(R: Array, p: Array) -> str:
        angles = np.arctan2(R[2, 1], R[2, 2]), -np.arcsin(np.clip(R[2, 0], -1, 1)), np.arctan2(R[1, 0], R[0, 0])
        return f'<origin xyz="{text(p)}" rpy="{text(np.array(angles))}"/>'

    def link(name: str, mass: float, com: Array) -> str:
        return (
            f'<link name="{name}"><inertial><origin xyz="{text(com)}"/><mass value="{mass:.17g}"/>'
            '<inertia ixx="1e-3" iyy="1e-3" izz="1e-3" ixy="0" ixz="0" iyz="0"/></inertial></link>'
        )

    parts = ['<robot name="chain">', link("base", chain.base_mass, chain.base_com)]
    parent = "base"
    for i, name in enumerate(chain.names):
        parts += [
            link(f"body_{name}", chain.mass[i], chain.com[i]),
            f'<joint name="{name}" type="revolute"><parent link="{parent}"/><child link="body_{name}"/>',
            place(chain.fixed_R[i], chain.fixed_p[i]),
            f'<axis xyz="{text(chain.axis[i])}"/>'
            f'<limit lower="{chain.q_min[i]:.17g}" upper="{chain.q_max[i]:.17g}" velocity="1e3" effort="10"/></joint>',
        ]
        parent = f"body_{name}"
    mounts = (
        ("tip", parent, chain.tip_R, chain.tip_p),
        ("pelvis", f"body_{chain.names[chain.pelvis_index]}", np.eye(3), chain.pelvis_point),
    )
    for name, carrier, R, p in mounts:
        parts.append(
            f'<link name="{name}"/><joint name="{name}_mount" type="fixed"><parent link="{carrier}"/>'
            f'<child link="{name}"/>{place(R, p)}</joint>'
        )
    return "".join([*parts, "</robot>"])
