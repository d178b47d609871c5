"""Parameters that are set during a walk: which are allowed, when they take effect, and how they are recorded."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from dqwalk_ros.config import Config, applies_from, from_yaml, load, to_yaml
from dqwalk_ros.plants.table import make_plant
from dqwalk_ros.report import bag
from dqwalk_ros.robot.model import load_model
from dqwalk_ros.simulation import simulate
from dqwalk_ros.support.errors import ConfigError
from dqwalk_ros.walks.table import make_controller

QUICK = {"standing.transfer_duration": 0.4, "standing.swing_duration": 0.4, "gait.steps": 2}
CONFIG = load("poppy").updated(QUICK)
MODEL = load_model(CONFIG.robot)
HIGHER = CONFIG.updated({"gait.step_height": 0.03})


def test_structural_parameters_are_not_live() -> None:
    live = {spec.name for spec in Config.specs() if spec.live}
    assert {"gait.step_height", "standing.swing_duration", "standing.balance", "monitor.rate"} <= live
    fixed = ("robot.", "output.", "poppy.", "physics.", "servo.", "whole_body.", "node.", "qp.", "dsp.", "ssp.")
    assert not any(name.startswith(fixed) or name in ("dt", "gait.steps", "gait.style") for name in live)


def test_a_configuration_stores_the_time_from_which_it_applies() -> None:
    text = to_yaml(HIGHER, 12_000_000_345)
    assert applies_from(text) == 12_000_000_345
    assert applies_from(to_yaml(CONFIG)) is None
    assert from_yaml(text) == HIGHER


def test_tuned_parameters_apply_from_the_next_phase_and_are_recorded(tmp_path: Path) -> None:
    controller, plant = make_controller(CONFIG, MODEL), make_plant("integrator", CONFIG, MODEL)

    def tune(time: float) -> None:
        if 0.1 <= time < 0.1 + CONFIG.dt:
            controller.tune(HIGHER)
            assert controller.config is CONFIG

    trace = simulate(controller, plant, before_step=tune)
    assert trace.finished, trace.notes
    assert [record.config for record in trace.phases] == [None] + [HIGHER] * (len(trace.phases) - 1)
    swing = trace.phases[1].phase(trace.config, MODEL)
    assert swing.tasks[0].height == HIGHER.gait.step_height
    bag.write(trace, tmp_path / "bag")
    read = bag.read(tmp_path / "bag")
    assert read.config == CONFIG
    assert [record.config for record in read.phases] == [record.config for record in trace.phases]


def test_tuning_a_paper_walk_is_refused() -> None:
    config = load("paper")
    with pytest.raises(ConfigError, match="keeps the parameters"):
        make_controller(config, load_model(config.robot)).tune(config)


# ---------------------------------------------------------------------- nodes


def test_param_set_is_logged_published_and_used_from_the_next_phase(make: Any) -> None:
    from rclpy.parameter import Parameter
    from std_msgs.msg import String

    from dqwalk_ros.nodes import messages as ros

    one, monitor = make("controller", CONFIG), make("phase_monitor", CONFIG)
    controller, plant = one.node._controller, make_plant("integrator", CONFIG, MODEL)

    def put(name: str, value: float) -> Any:
        return one.node.set_parameters([Parameter(name, value=value)])[0]

    for k in range(400):
        one.exchange(plant, MODEL, 1.0 + k * CONFIG.dt)
        if k == 10:
            assert put("gait.step_height", 0.03).successful
            assert not put("gait.step_height", 3.0).successful
            assert (
                "while the robot walks it may be 0.02 to 0.045: set it in steps" in put("gait.step_height", 0.05).reason
            )
            assert "the robot would stand still" in put("plant.command_timeout", 0.0).reason
            assert not put("gait.steps", 7).successful  # structural
            assert put("monitor.warn_margin", 0.001).successful
        if controller.phase_index == 1:
            break
    assert controller.phase_index == 1
    assert "gait.step_height: 0.02 -> 0.03" in one.log
    first, tuned = (msg.data for msg in one.got["walk_config"])
    start = one.got["phase_start"][-1]
    assert applies_from(first) is None
    assert applies_from(tuned) == ros.nanoseconds(start.header.stamp)
    assert from_yaml(tuned).gait.step_height == 0.03
    for topic in ("walk_config", "robot_description", "phase_start", "com_target", "swing_target"):
        for msg in one.got[topic]:
            monitor.send(topic, msg if topic != "walk_config" else String(data=msg.data))
    began = [ros.nanoseconds(msg.header.stamp) for msg in one.got["phase_start"]]
    phases = [monitor.node._phases.at(stamp)[1].phase for stamp in began]
    assert phases[1].tasks[0].height == 0.03
    assert monitor.node._phases.config.gait.step_height == 0.02


def test_param_set_on_a_paper_walk_is_refused(make: Any) -> None:
    from rclpy.parameter import Parameter

    one = make("controller", load("paper"))
    answer = one.node.set_parameters([Parameter("task.eta", value=0.1)])[0]
    assert not answer.successful
    assert "keeps the parameters" in answer.reason
    assert one.node.set_parameters([Parameter("monitor.rate", value=5.0)])[0].successful
