"""Pushes, bottles on ropes, and the largest that is survived."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from dqwalk_ros import cli
from dqwalk_ros.config import load, overlaid
from dqwalk_ros.paper.foot import Foot
from dqwalk_ros.paper.kinematics import Kinematics
from dqwalk_ros.paper.state import Command
from dqwalk_ros.plants.kinematic import KinematicPlant
from dqwalk_ros.robot.model import load_model
from dqwalk_ros.studies import loads, pushes
from dqwalk_ros.support.errors import PlantError
from dqwalk_ros.walks.table import make_walk

POPPY = load("poppy")


def test_pushes_scale_with_the_robot():
    scale = pushes.impulse_scale(POPPY)
    assert scale == pytest.approx(5.5, abs=0.3)
    data = Path(__file__).parents[1] / "data"
    big = load(data / "biped12.yaml").updated({"robot.urdf": str(data / "biped12.urdf")})
    assert pushes.impulse_scale(big) > 1.5 * scale


def test_limits_of_pushes_are_saved_and_printed(tmp_path, monkeypatch, capsys):
    def pushed(config, push):
        assert config.servo.assumed_damping == 0.02  # of config/plants/physics.yaml, as with `dqwalk simulate`
        return "fell" if push.impulse > 0.8 + 0.1 * push.direction else ""

    monkeypatch.setattr(pushes, "pushed", pushed)
    command = ["pushes", "--moment", "standing", "--directions", "4", "--jobs", "1", "--out", str(tmp_path)]
    assert cli.main(command) == 0
    shown = capsys.readouterr().out
    assert "M sqrt(g h)" in shown
    rows = [line.split(",") for line in (tmp_path / "pushes.csv").read_text().splitlines()[1:]]
    for moment, degrees, survived, failed, reason in rows:
        limit = 0.8 + 0.1 * float(degrees) * 3.14159265 / 180
        assert (moment, reason) == ("standing", "fell")
        assert float(survived) <= limit < float(failed)
    monkeypatch.setattr(pushes, "pushed", lambda config, push: pytest.fail("it is kept"))
    assert cli.main([*command, "--quiet"]) == 0
    assert capsys.readouterr() == ("", "")
    assert (tmp_path / "pushes.txt").read_text() == shown


@pytest.mark.parametrize(("given", "length"), [((), 0.0), (("--set", "gait.step_length=0.03"), 0.03)])
def test_the_bottle_of_robocup_is_measured_by_the_rules(given, length, tmp_path, monkeypatch, capsys):
    """M and the distance of the release, of the weaker foot; on the spot, unless the steps are given."""

    def pushed(config, push):
        assert config.gait.step_length == length
        assert push.bottle == 3.0
        return "fell" if push.impulse > (2.0 if push.direction > 1.0 else 3.0) + (push.moment == "left") else ""

    monkeypatch.setattr(pushes, "pushed", pushed)
    command = ["pushes", "--bottle", "3", *given, "--out", str(tmp_path)]
    assert cli.main([*command, "--jobs", "1", "--tolerance", "1e-4"]) == 0
    shown = capsys.readouterr().out
    model = load_model(POPPY.robot)
    kin = Kinematics(model, make_walk(POPPY, model).posture, Foot.LEFT)
    for where, momentum in (("from behind", 3.0), ("from the front", 2.0)):
        drop = (momentum / 3.0) ** 2 / (2.0 * 9.81)
        away = math.sqrt(1.75**2 - (1.75 - drop) ** 2)
        measure = math.sqrt(drop) / kin.com[2] * 3.0 / model.mass * kin.point(model.pelvis)[2] / kin.com[2]
        assert f"{where}: released {away:.2f} m away, on a rope of 1.75 m: M = {measure:.2f}" in shown
    assert cli.main([*command, "--moment", "standing"]) == 2


def test_another_link_is_pushed(tmp_path, monkeypatch, capsys):
    """The link of --link is pushed, and named in the table; one that the robot has not is an error."""
    monkeypatch.setattr(
        pushes, "pushed", lambda config, push: "fell" if push.impulse > 0.7 or push.link != "chest" else ""
    )
    command = ["pushes", "--jobs", "1", "--moment", "standing", "--directions", "1", "--out", str(tmp_path)]
    assert cli.main([*command, "--link", "chest", "--tolerance", "1e-3"]) == 0
    shown = capsys.readouterr().out
    assert "impulse of a push of 0.1 s on chest" in shown
    assert ">= " not in shown
    assert "0.699 (0.81)" in shown
    assert "in brackets: what a pendulum on these soles catches" in shown
    assert cli.main([*command, "--link", "wing"]) == 2
    assert "--link wing: the links of poppy_humanoid are" in capsys.readouterr().err
    assert cli.main([*command, "--link", "chest", "--bottle", "3"]) == 2


def test_pushes_anywhere_are_drawn_by_their_seed():
    """Over all heavy links, both feet, all directions and the whole step."""
    model = load_model(POPPY.robot)
    drawn = [pushes.Push.anywhere(0.3, model, seed) for seed in range(300)]
    assert drawn[7] == pushes.Push.anywhere(0.3, model, 7)
    heavy = {link for link, body in zip(model.links, model.bodies, strict=True) if body.mass > 0.02 * model.mass}
    assert {push.link for push in drawn} == heavy
    assert {push.moment for push in drawn} == {"left", "right"}
    for values, most in (([push.direction for push in drawn], 2.0 * math.pi), ([push.part for push in drawn], 0.95)):
        counts, _ = np.histogram(values, 4, (0.0, most))
        assert counts.sum() == 300
        assert counts.min() > 45


@pytest.mark.parametrize("mass", [3.0, 10.0])
@pytest.mark.parametrize("dt", [0.0025, 0.005, 0.02])
def test_a_bottle_loses_the_momentum_that_a_free_body_receives(mass, dt):
    """The hit is nearly inelastic, for any period of control."""
    bottle, robot, x, v = loads.Bottle(mass, 2.0, 2.6), 2.6, 0.0, 0.0
    impulse = [dt * bottle.force(x, dt)]
    while impulse[-1] > 0.0:
        v += impulse[-1] / robot
        x += v * dt
        impulse.append(dt * bottle.force(x, dt))
    inelastic = 2.0 * robot / (mass + robot)
    assert inelastic < sum(impulse) < 1.15 * inelastic
    assert len(impulse) * dt < 0.2


def test_the_farthest_bottle_is_released_at_three_quarters_of_the_rope():
    for mass in (3.0, 5.0, 10.0):
        assert loads.release_distance(mass, loads.farthest_momentum(mass)) == pytest.approx(0.75 * loads.ROPE)


@pytest.mark.long
def test_a_bottle_on_a_walk_on_the_spot():
    """Poppy walks on after 1.5 N s, and falls after 6, from behind and from the front."""
    config = overlaid(load("poppy_dynamic"), "physics").updated({"gait.step_length": 0.0})
    for direction in (0.0, math.pi):
        assert not pushes.pushed(config, pushes.Push("left", direction, 1.5, bottle=3.0))
        assert "fell" in pushes.pushed(config, pushes.Push("left", direction, 6.0, bottle=3.0))


def test_a_small_push_is_survived_and_a_large_one_is_not():
    assert not pushes.pushed(POPPY, pushes.Push("standing", 0.0, 0.1))
    assert "fell" in pushes.pushed(POPPY, pushes.Push("standing", 0.0, 3.0))


@pytest.mark.parametrize(("duration", "dt"), [(0.1, 0.005), (0.1, 0.03), (0.012, 0.005), (0.001, 0.005)])
def test_the_impulse_of_a_push_does_not_depend_on_the_period(monkeypatch, duration, dt):
    """The integral of the force over the ticks is the impulse, also if the duration is no multiple of the period.

    It acts on the link of the push.
    """
    given = []

    class Pushed(KinematicPlant):
        def push(self, force, link=""):
            assert link == "chest"
            given.append(np.asarray(force) * dt)

    class Standing:
        finished = False

        def __init__(self, config):
            self.config = config

        def step(self, state, dt):
            return Command(state.time, np.zeros_like(state.q))

    monkeypatch.setattr(pushes, "make_controller", lambda config, model: Standing(config))
    monkeypatch.setattr(pushes, "make_plant", lambda name, config, model: Pushed(model, np.zeros(model.n)))
    monkeypatch.setattr(pushes, "_due", lambda controller, time, number, part: time > 0.1)
    monkeypatch.setattr(pushes, "_STANDS", 0.3)
    assert not pushes.pushed(POPPY.updated({"dt": dt}), pushes.Push("standing", 0.0, 2.0, duration, link="chest"))
    assert sum(given) == pytest.approx([2.0, 0.0, 0.0])


def test_a_push_in_a_phase_that_never_begins_is_an_error(monkeypatch):
    monkeypatch.setattr(pushes, "_due", lambda controller, time, number, part: False)
    monkeypatch.setattr(pushes, "_LATE", -1.0)
    monkeypatch.setattr(pushes, "_STANDS", 0.1)
    with pytest.raises(PlantError, match="before the push"):
        pushes.pushed(POPPY, pushes.Push("standing", 0.0, 0.1))
