"""The schema of the configuration: rejected files with their line, round trips, and the values of paper.yaml."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
import yaml

from dqwalk_ros.config import SHIPPED, Config, find_file, find_share, from_yaml, load, to_yaml, with_files
from dqwalk_ros.config.files import OVERLAYS
from dqwalk_ros.robot.model import find_urdf
from dqwalk_ros.support.errors import ConfigError, ModelError

ROOT = Path(__file__).parents[2]


def text(body: str) -> str:
    return "/**:\n  ros__parameters:\n" + "\n".join("    " + line for line in body.splitlines()) + "\n"


# ---------------------------------------------------------------------- parameters of section 5

SECTION_5 = {
    "dt": 0.005,  # integration step
    "task.eta": 0.05,
    "task.damping": 0.1,
    "task.posture_weight": 0.0,
    "dsp.eta_sliding": 5.0,
    "dsp.eta_ground": 5.0,
    "dsp.eta_tip": 10.0,
    "dsp.eta_back": 20.0,
    "dsp.sliding_radius": 0.04,
    "pelvis.eta": 500.0,
    "pelvis.height": 0.2,
    "joints.eta": 10.0,
    "ssp.eta_com": 5.0,
    "ssp.com_radius": 0.05,
    "ssp.threshold": 0.001,
    "gait.step_length": 0.05,
    "robot.sole_width": 0.07,
    "robot.sole_length": 0.0934,
}


def test_paper_yaml_contains_the_parameters_of_section_5():
    stated = yaml.safe_load(find_share("config", "paper.yaml").read_text(encoding="utf-8"))
    body = stated["/**"]["ros__parameters"]
    flat = {"dt": body["dt"]} | {f"{s}.{k}": v for s, d in body.items() if isinstance(d, dict) for k, v in d.items()}
    for name, value in SECTION_5.items():
        assert flat[name] == value, name
    config = load("paper").flat()
    assert {name: config[name] for name in SECTION_5} == SECTION_5


# ---------------------------------------------------------------------- rejected configurations

HEAD = "/**:\n  ros__parameters:\n"
BOMB = "a: &a [x, x]\n" + "".join(f"{b}: &{b} [*{a}, *{a}]\n" for a, b in zip("abcdefgh", "bcdefghi", strict=True))
REAL = r"line 3: 'task.eta' must be a number in \[1e-06, 1000\], got "
VALUES = [
    ("dps: {eta_tip: 3.0}", r"line 3: unknown parameter 'dps.eta_tip'; did you mean 'dsp.eta_tip'"),
    ("gait:\n  cylces: 2", r"line 4: unknown parameter 'gait.cylces'; did you mean 'gait.cycles'"),
    ("com_radius: 3.0", r"unknown parameter 'com_radius'; did you mean .*'ssp.com_radius'"),
    ("task: {eta: fast}", REAL + r"'fast' \(convergence rate .*\[1/s\]"),
    ("task: {eta: true}", REAL + "True"),
    ("task: {eta: [0.1]}", REAL),
    ("task: {eta: .nan}", REAL + "nan"),
    ("task: {eta: .inf}", REAL + "inf"),
    ("task: {eta: -0.1}", REAL + "-0.1"),
    ("task: {eta: null}", REAL + "None"),
    (f"task: {{eta: {'9' * 400}}}", REAL),
    ("gait: {cycles: 1.5}", r"'gait.cycles' must be a whole number in \[1, 100000\], got 1.5"),
    ("gait: {cycles: true}", r"'gait.cycles' must be a whole number"),
    ("gait: {cycles: 0}", r"'gait.cycles' must be a whole number in \[1, 100000\]"),
    ("gait: {first_support: middle}", r"'gait.first_support' must be one of left, right, got 'middle'"),
    ("dsp: {flat_feet: 1}", r"'dsp.flat_feet' must be true or false, got 1"),
    ("dsp: {flat_feet: 'yes'}", r"'dsp.flat_feet' must be true or false"),
    ("robot: {urdf: 3}", r"'robot.urdf' must be a text, got 3"),
    ("robot: {drop: abs_y}", r"'robot.drop' must be a list of texts, got 'abs_y'"),
    ("robot: {drop: [1]}", r"'robot.drop' must be a list of texts"),
    ("qp: {solver: magic}", r"'qp.solver' must be one of"),
    ("3: 4", r"the key 3 is not a text"),
    ("gait: {step_length: 0,04}", r"the key gait.4 is not a text; is a number before it written with a comma"),
    ("servo: {torque_scale: 0.0}", r"'servo.torque_scale' must be a number in \[0.001, 100\]"),  # MuJoCo refuses it
    ("dt: 0.005\ndt: 0.01", "line 4: .*'dt' was given in line 3"),
    ("gait: {cycles: 1}\ngait: {cycles: 2}", "line 4: .*'gait' was given in line 3"),
    ("gait.cycles: 1\ngait: {cycles: 2}", "'gait.cycles' is given twice"),
    (f"dt: {'9' * 5000}", "not YAML"),
    ("dt: \u0660.\u0660\u0661", "line 3: 'dt' must be a number"),  # digits, but not those of YAML
    ("use_sim_time: maybe", "line 3: 'use_sim_time' must be true or false"),
    ("dt: 2001-01-01", "'dt' must be a number"),
    ("dt:\u00a00.005", "line 3: not YAML: the blank U\\+00A0"),
    ("robot: {urdf: a\u200bb}", "line 3: not YAML: the blank U\\+200B"),
    ("robot: {imu_rpy: [90, 0, 0]}", r"'robot.imu_rpy' must be a list of 3 numbers in \[-6.3, 6.3\], got \[90"),
    ("robot: {imu_rpy: [0, 0]}", "'robot.imu_rpy' must be a list of 3 numbers"),
    ("robot: {imu_rpy: [0, 0, .nan]}", "'robot.imu_rpy' must be a list of 3 numbers"),
    ("robot: {left_sole_xyz: [0, 1e308, 0]}", r"must be a list of 3 numbers in \[-10, 10\]"),
    ("dt: [1", "line 4: not YAML"),
    ("dt: *x", "line 3: not YAML: anchors"),
    ("<<: {dt: 1}", "line 3: not YAML: merge keys"),
    ("dt: !x 1", "line 3: not YAML"),
    ("? [a]\n: 1", "line 3: not YAML: found unhashable key"),
]
FILES = {
    "a node twice": ("/**: {ros__parameters: {}}\n/**: {ros__parameters: {}}\n", "line 2: .*was given in line 1"),
    "a tab": (HEAD + "\tdt: 1\n", "line 3: not YAML: a tab"),
    "thousands of parameters": (HEAD + "".join(f"    p{k}: 1\n" for k in range(2001)), "has 2001 parameters; at most"),
    "a bomb": (BOMB, "line 1: not YAML: anchors"),
    "code": ("!!python/object/apply:os.system ['true']", "not YAML"),
    "two documents": (f"{HEAD}    dt: 0.005\n---\n{HEAD}    dt: 0.01\n", "not YAML"),
    "too deep": ("[" * 100, "nested too deeply"),
    "deeper than libyaml reads": ("[" * 3000, "nested too deeply|nesting depth"),
    "very deep": ("- " * 300_000, "nested too deeply"),
    "too long": ("#" * (1 << 20) + "\n", "longer than 1 MiB"),
    "a zero": ("\x00", "not YAML"),
    "empty": ("", r"expected '/\*\*"),
    "a list": ("[1, 2]", r"expected '/\*\*"),
    "no node": ("dt: 0.005", r"expected '/\*\*"),
    "no ros__parameters": ("/**:\n  parameters:\n    dt: 0.005", r"expected '/\*\*: \{ros__parameters"),
    "a section of parameters": ("robot: {mass: 3.2}", r"'robot.mass': expected '/\*\*: \{ros__parameters"),
    "a number of parameters": ("/**:\n  ros__parameters: 3", "ros__parameters': must hold parameters"),
    "no parameters": ("/**:\n  ros__parameters:\n", "ros__parameters': must hold parameters"),
}
REFUSED = {body[:60]: (text(body), message) for body, message in VALUES} | FILES


@pytest.mark.parametrize("name", REFUSED)
def test_invalid_files_are_rejected_with_the_line(name):
    whole, message = REFUSED[name]
    with pytest.raises(ConfigError, match=message) as caught:
        from_yaml(whole, source="mine.yaml")
    assert str(caught.value).startswith(("mine.yaml: ", "mine.yaml, line "))
    assert len(str(caught.value)) < 1000


def test_an_unknown_name_that_resembles_none_is_refused_where_it_can_belong_to_no_other_package():
    with pytest.raises(ConfigError, match=r"unknown parameter 'zzz'; `dqwalk config` lists them all"):
        Config().updated({"zzz": 3.0})


def test_missing_and_unreadable_files(tmp_path):
    (tmp_path / "folder.yaml").mkdir()
    (tmp_path / "link.yaml").symlink_to("link.yaml")
    for source, expected in (
        (tmp_path / "nowhere.yaml", r"no configuration '.*nowhere.yaml'$"),
        (tmp_path / "folder.yaml", r"folder.yaml' is a folder; name the configuration$"),
        (tmp_path / "link.yaml", r"link.yaml': it is a link that leads nowhere$"),
        ("~/mine.yaml", r"no configuration '~/mine.yaml': no shell has replaced the '~'; write the whole path$"),
        ("papre", r"no configuration 'papre': neither a file nor one of paper"),
        (" ", "the name of the configuration is empty"),
        ("a" * 300, "cannot read the configuration 'a+': File name too long"),
    ):
        with pytest.raises(ConfigError, match=expected):
            load(source)
    (tmp_path / "binary.yaml").write_bytes(b"\xff\xfe\x00\x80")
    with pytest.raises(ConfigError, match=r"cannot read|not YAML"):
        load(tmp_path / "binary.yaml")


@pytest.mark.parametrize("name", ["task.eta", "gait.cycles"])
def test_bounds_are_inclusive(name):
    """Both bounds are allowed, values beyond them are rejected: of a real and of a whole number."""
    (spec,) = (spec for spec in Config.specs() if spec.name == name)
    for end, step in ((spec.low, -1), (spec.high, 1)):
        value = int(end) if spec.type is int else end
        assert Config().updated({spec.name: value}).flat()[spec.name] == value
        beyond = value + step if spec.type is int else float(np.nextafter(value, step * np.inf))
        with pytest.raises(ConfigError, match=f"'{spec.name}' must be a .*number in"):
            Config().updated({spec.name: beyond})


# ---------------------------------------------------------------------- round trips


def test_integers_and_exponents_are_accepted_as_floats():
    """The exponent as in rcl; by YAML 1.1 alone it would be a string."""
    for body, expected in (("task: {eta: 1}", 1.0), ("task: {eta: 5e-2}", 0.05)):
        value = from_yaml(text(body)).task.eta
        assert value == expected
        assert isinstance(value, float)


def test_numbers_and_arrays_of_numpy_are_accepted():
    """As in a sweep of a script over np.linspace; they are written as other numbers."""
    given = {"gait.step_length": np.float64(0.05), "gait.steps": np.int64(3), "dynamic.catch": np.bool_(False)}
    changed = load("poppy_dynamic").updated({**given, "robot.payload": np.array(["l_hand=0.1"])})
    assert (changed.gait.step_length, changed.gait.steps, changed.dynamic.catch) == (0.05, 3, False)
    assert type(changed.gait.step_length) is float
    with pytest.raises(ConfigError, match="must be a whole number"):
        load("poppy").updated({"gait.steps": np.float64(2.5)})


def test_unspecified_parameters_keep_their_default():
    assert from_yaml(text("dt: 0.01")) == dataclasses.replace(Config(), dt=0.01)


def other_value(spec):
    """Return a value that is not the default."""
    if spec.type is bool:
        return not spec.default
    if spec.choices:
        return spec.choices[-1]
    if spec.type is int:
        return spec.default + (1 if spec.default < spec.high else -1)
    if spec.type is float:
        return 0.3 * spec.default + 0.7 * (spec.high if spec.default == spec.low else spec.low)
    if spec.type is tuple:
        return (0.1, 0.2, 0.3) if spec.default else ("a", "b*")
    return "something"


def test_files_preserve_all_parameters(tmp_path):
    config = Config().updated({spec.name: other_value(spec) for spec in Config.specs()})
    changed = {n for n, v in config.flat().items() if v != Config().flat()[n]}
    assert changed >= {spec.name for spec in Config.specs() if len(spec.choices) != 1}
    for one in (config, Config(), load("paper")):
        assert from_yaml(to_yaml(one)) == one
        path = tmp_path / "config.yaml"
        path.write_text(to_yaml(one), encoding="utf-8")
        assert load(path) == one
        assert Config().updated(one.flat()) == one


def test_every_parameter_has_a_meaning_and_bounds():
    specs = Config.specs()
    assert len({spec.name for spec in specs}) == len(specs)
    for spec in specs:
        assert len(spec.meaning) > 5, spec.name
        if spec.type in (int, float):
            assert spec.low is not None, spec.name
            assert spec.low <= spec.default <= spec.high, spec.name


def test_records_are_frozen(paper):
    with pytest.raises(dataclasses.FrozenInstanceError):
        paper.task.eta = 3.0
    assert hash(paper) == hash(load("paper"))


def test_every_shipped_configuration_is_named() -> None:
    files = {path.stem: path for path in (Path(__file__).parents[2] / "config").glob("*.yaml")}
    walks = {name for name, path in files.items() if "robot:" in path.read_text(encoding="utf-8")}
    assert set(SHIPPED) == walks


def test_a_folder_of_results_hides_no_file_of_the_package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Else `dqwalk evidence`, which writes to a folder of its name, could not be continued."""
    monkeypatch.chdir(tmp_path)
    for name, folder in (("evidence", "config"), ("paper", "config"), ("rough", "config/overlays")):
        Path(name).mkdir()
        assert find_file("file", name, folder, (name,)) == ROOT / folder / f"{name}.yaml"


@pytest.mark.parametrize("name", SHIPPED)
def test_every_shipped_configuration_is_solved_without_optional_packages(name: str) -> None:
    assert load(name).qp.solver == "clarabel"


def test_a_ground_is_given_by_its_name() -> None:
    walk = load("poppy_dynamic")
    rough = with_files(walk, [Path("rough")])
    assert rough.servo.window < walk.servo.window
    assert rough.standing.swing_duration < walk.standing.swing_duration
    assert sorted(OVERLAYS) == sorted(path.stem for path in (ROOT / "config/overlays").iterdir())
    with pytest.raises(ConfigError, match="no parameter file 'swamp': neither a file nor one of arms, climb, rough"):
        with_files(walk, [Path("swamp")])


@pytest.mark.parametrize(
    ("urdf", "expected"),
    [
        ("package://poppy/poppy.urdf", "robot.urdf is 'package://.*it must be a path"),
        (" <robot>" + 10_000 * "<link/>", r"robot.urdf is '<robot>(<link/>){1,42}.{,9}'; it must be a path"),
        ("~/robot.urdf", r"no robot description '~/robot.urdf': no shell has replaced .* \(robot.urdf\)$"),
        ("", r"the name of the robot description is empty \(robot.urdf\)$"),
        (".", "'.' is a folder"),
    ],
)
def test_a_robot_that_is_not_found_is_said_with_its_parameter(urdf: str, expected: str) -> None:
    with pytest.raises(ModelError, match=expected):
        find_urdf(urdf)
