"""The HTML report: complete, self-contained, and small."""

from __future__ import annotations

import dataclasses
import json
import re
import resource
import time
from base64 import b64decode
from html import escape
from pathlib import Path

import numpy as np
import pytest
from recorded import repeated, rewrite, short_config, short_walk

from dqwalk_ros import cli, load, load_model, make_controller, report, simulate
from dqwalk_ros.cli.report import _names
from dqwalk_ros.config import to_yaml
from dqwalk_ros.paper.dual_quaternions import DQ
from dqwalk_ros.plants.kinematic import KinematicPlant
from dqwalk_ros.report import bag
from dqwalk_ros.report.bag.messages import diagnostics_of, faults
from dqwalk_ros.report.figures import FIGURES
from dqwalk_ros.report.figures.style import new_figure
from dqwalk_ros.report.html.page import Subject, _heading
from dqwalk_ros.report.html.replay import _moving, replay_data
from dqwalk_ros.report.scene import Moments, Scene, tightest
from dqwalk_ros.report.table import numbers


def simple(series):
    """A figure that is drawn in place of all others, because drawing dominates the time."""
    figure = new_figure(2.0, 1.0)
    figure.subplots().plot(series.time, series.error)
    return figure


@pytest.fixture
def one_figure(monkeypatch):
    monkeypatch.setattr("dqwalk_ros.report.figures.FIGURES", {"figure9": (simple, "Figure 9")})


@pytest.fixture(scope="module")
def page(path, tmp_path_factory):
    out = tmp_path_factory.mktemp("out")
    quick = {name: (simple, caption) for name, (_, caption) in FIGURES.items()}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("dqwalk_ros.report.figures.FIGURES", quick)
        cli.main(["report", str(path), "--html", "--csv", "--no-figures", "--quiet", "--out", str(out)])
    return out


def test_the_page_is_small_and_self_contained(page):
    text = (page / "report.html").read_text()
    assert len(text) < 5e6
    assert not re.findall(r"""(?:src|href)=['"](?!data:)""", text)
    assert not re.findall(r"https?://(?!www\.w3\.org)", re.sub(r"base64,[^'\"]*", "", text))


def test_the_page_contains_the_report(page):
    text, report = (page / "report.html").read_text(), json.loads((page / "report.json").read_text())
    for phase in report["phases"]:
        assert phase["name"] in text
    for joint in report["robot"]["joints"]:
        assert f"<td>{joint}</td>" in text
    for key in report["config"]:
        assert f"<td>{key}</td>" in text
    assert ("every constraint kept" in text) == report["ok"]
    assert text.count("data:image/svg+xml") == 4
    assert f"{report['walk']['duration']:.1f} s" in text


def test_the_replay_shows_the_view_of_each_state():
    """In every frame, the bodies, the support polygon and the regions are those of the `View`."""
    trace = short_walk()
    data, scene, moments = replay_data(report.analyse(trace)), Scene(trace.config, trace.model), Moments(trace)
    t, bodies, points = (np.frombuffer(b64decode(v), "<f4") for v in (data["t"], data["bodies"], data["polygons"]["v"]))
    bodies = bodies.reshape(len(t), -1, 7)
    polygons = np.split(points.reshape(-1, 3), np.cumsum(list(b64decode(data["polygons"]["counts"]))))
    regions = {r["name"]: np.frombuffer(b64decode(r["v"]), "<f4").reshape(len(t), 10) for r in data["regions"]}
    assert ((bodies[1:, :, 3:] * bodies[:-1, :, 3:]).sum(axis=-1) > 0.9).all()  # so that they can be interpolated
    for row in np.linspace(0, len(t) - 1, 25).astype(int):
        view = scene.look(moments.at(int(np.argmin(np.abs(trace.time - trace.time[0] - t[row])))))
        drawn = {region.name: region for region in view.regions}
        assert {name for name, values in regions.items() if np.isfinite(values[row]).all()} == set(drawn)
        placed = [(x, view.bodies[k]) for k, x in enumerate(bodies[row])]
        placed += [(regions[name][row], region.region.pose) for name, region in drawn.items()]
        for shown, pose in placed:
            away = DQ.from_pose(shown[:3], shown[3:7]).conj() * DQ(pose)
            assert np.abs(np.append(away.translation(), away.rotation_vector())).max() < 1e-5
        for name, region in drawn.items():
            np.testing.assert_allclose(regions[name][row, 7:], region.extent, atol=1e-6)
        np.testing.assert_allclose(polygons[row], view.polygon, atol=1e-5)
        assert data["tight"]["names"][b64decode(data["tight"]["at"])[row]] == tightest(view.gauges).name


def test_poses_of_a_replay_can_be_interpolated() -> None:
    """A unit quaternion and its opposite are the same orientation; the mean of both is none."""
    x = DQ.from_pose([0.1, 0.2, 0.3], [0.6, 0.8, 0.0, 0.0]).vec8()
    shown = _moving(np.array([[x], [-x], [-x], [x]]))
    np.testing.assert_allclose(shown, np.broadcast_to(shown[0], shown.shape), atol=1e-12)


def test_the_page_shows_the_origin_of_the_walk_and_of_the_report(path, tmp_path, one_figure):
    walked = {"began": "2020-02-20 20:20:20 UTC", "numpy": "1.2.3", "host": "the <lab>"}
    bag.write(dataclasses.replace(short_walk(), origin=walked), tmp_path / "old", diagnostics=False)
    assert bag.read(tmp_path / "old").origin == walked
    cli.main(["report", str(tmp_path / "old"), "--html", "--no-figures", "--quiet", "--out", str(tmp_path / "out")])
    text = (tmp_path / "out/report.html").read_text()
    assert "<tr><td>at</td><td>2020-02-20 20:20:20 UTC</td>" in text
    assert f"<tr><td>numpy</td><td>1.2.3</td><td>{np.__version__}</td></tr>" in text
    assert "the &lt;lab&gt;" in text
    without_origin = rewrite(tmp_path / "old", tmp_path / "older", rename=lambda t: None if t == "/walk_origin" else t)
    assert bag.read(without_origin).origin == {}


@pytest.mark.parametrize(
    ("bags", "titles"),
    [
        (["/lab/one/bag"], ["one/bag"]),
        (["/lab/one"], ["one"]),
        (["/lab/one/walk/bag", "/lab/two/walk/bag"], ["one/walk/bag", "two/walk/bag"]),
        (["/lab/one", "/lab/one"], ["one", "one"]),
        (["/one", "/lab/one"], ["one", "lab/one"]),
    ],
)
def test_walks_that_are_compared_have_titles_that_differ(bags, titles):
    assert _names(*map(Path, bags)) == titles


def test_two_walks_side_by_side(path, tmp_path, one_figure):
    trace = short_walk()
    other = tmp_path / "wider"
    bag.write(dataclasses.replace(trace, config=short_config(**{"ssp.com_radius": 0.06})), other)
    cli.main(["report", str(path), "--compare", str(other), "--no-figures", "--quiet", "--out", str(tmp_path / "out")])
    text = (tmp_path / "out/comparison.html").read_text()
    assert "Side by side" in text
    assert "<td>ssp.com_radius</td><td>0.05</td><td>0.06</td>" in text
    assert "id='stage1'" in text
    assert text.count("data:image/svg+xml") == 2


def test_a_page_is_added_to_an_earlier_report(path, tmp_path):
    """Its pictures, drawn first in another format, have the same layout, so the files of the report stay."""
    for options in ([], ["--html"], []):
        assert cli.main(["report", str(path), "--out", str(tmp_path), "--quiet", *options]) == 0
    assert (tmp_path / "report.html").exists()


def test_a_page_that_exists_is_refused_before_the_walk_is_evaluated(path, tmp_path, monkeypatch, capsys):
    """That of one walk and that of two are different files."""
    (tmp_path / "report.html").touch()
    (tmp_path / "comparison.html").touch()
    monkeypatch.setattr(bag, "read", lambda *_, **__: pytest.fail("it is read"))
    for option, name in (("--html", "report.html"), (f"--compare={path}", "comparison.html")):
        assert cli.main(["report", str(path), option, "--out", str(tmp_path)]) == 1
        assert f"{name}' exists already" in capsys.readouterr().err


def test_a_standing_walk_beside_a_paper_walk(path, tmp_path, one_figure):
    """A standing walk has no paper margin: its table cell is empty."""
    config = load("poppy").updated({"gait.steps": 1})
    model = load_model(config.robot)
    trace = simulate(make_controller(config, model), KinematicPlant(model), max_time=1.0)
    bag.write(trace, tmp_path / "standing", diagnostics=False)
    out = ["--no-figures", "--quiet", "--out", str(tmp_path / "out")]
    code = cli.main(["report", str(tmp_path / "standing"), "--compare", str(path), *out])
    assert code == 1  # the walk did not finish
    text = (tmp_path / "out/comparison.html").read_text()
    assert "stopped before its end" in text
    assert "<td>paper margin</td><td class=n>–</td><td class=n>+" in text
    assert text.count("smallest paper margin") == 1


def test_a_dynamic_walk_shows_pressure_and_tilt_instead_of_the_margin_of_the_com():
    series = report.analyse(short_walk())
    found = report.report(series)
    assert "true margin" in dict(numbers(found))
    physics = {"cop_margin": -7e-4, "tilt": {"value": np.radians(0.05)}}
    found |= {"walk": found["walk"] | {"style": "dynamic"}, "physics": physics}
    del found["walk"]["margin"]["paper"]
    text = _heading(Subject("walk", series, found, [], []))
    assert "margin of the CoM" not in text
    assert "paper margin" not in text
    assert "<span>smallest margin of the centre of pressure</span><b>-0.70 mm</b>" in text
    assert "<span>largest tilt of the loaded sole</span><b>0.05°</b>" in text
    assert "true margin" not in dict(numbers(found | {"physics": None}))


def test_names_are_escaped(path, tmp_path, one_figure):
    """Names of joints, robots, parameters and bags are escaped."""
    tag, config = "<img src=x onerror=alert(1)>", short_config(**{"poppy.lower_port": "<img src=y>"})

    def rename(topic, stamp, message):
        if topic == "/robot_description":
            message.data = message.data.replace("l_knee_y", escape(tag)).replace("poppy_humanoid", "&lt;!--&lt;script>")
        elif topic == "/walk_config":
            message.data = to_yaml(config)
        elif hasattr(message, "name"):
            message.name = [tag if name == "l_knee_y" else name for name in message.name]
        return stamp, message

    hostile = rewrite(path, tmp_path / "<img src=z>", edit=rename)
    out = ["--no-figures", "--quiet", "--out", str(tmp_path / "out")]
    cli.main(["report", str(hostile), "--compare", str(path), *out])
    text = (tmp_path / "out/comparison.html").read_text()
    assert "<img src=" not in re.sub(r"<img alt=[^>]*>", "", text)
    assert "&lt;img src=x" in text
    assert "&lt;img src=y" in text
    assert "&lt;img src=z" in text
    assert "<!--" not in text
    assert text.count("</script>") == 2


def test_series_as_csv(page):
    trace = short_walk()
    with (page / "series.csv").open() as file:
        head = file.readline().strip().split(",")
        table = np.genfromtxt(file, delimiter=",")
    assert table.shape == (len(trace), len(head))
    np.testing.assert_allclose(table[:, 0], trace.time, atol=1e-6)
    np.testing.assert_allclose(table[:, 2 : 2 + trace.model.n], trace.q, atol=1e-8)


def test_repeated_faults_are_listed_once(path, tmp_path):
    def reject(topic, stamp, message):
        if topic == "/diagnostics" and stamp > 5_000_000_000:
            message.status[0].level = 2
            message.status[0].message = f"joint_states rejected ({stamp} so far)"
        return stamp, message

    found = faults(diagnostics_of(rewrite(path, tmp_path / "b", edit=reject)))
    assert found[0].level == "ERROR"
    assert found[0].count > 10
    assert sum("rejected" in fault.message for fault in found) == 1
    assert found[0].first == pytest.approx(5.0, abs=0.2)


@pytest.mark.long
@pytest.mark.timeout(600)
def test_a_report_of_ten_minutes_is_fast(tmp_path):
    """120 000 states need less than 20 s of CPU time and 1 GiB of memory."""
    trace = short_walk()
    bag.write(repeated(trace, -(-120_000 // len(trace))), tmp_path / "long")
    began = time.process_time()
    cli.main(["report", str(tmp_path / "long"), "--html", "--quiet", "--out", str(tmp_path / "out")])
    assert time.process_time() - began < 20.0
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss < 1 << 20
    assert (tmp_path / "out/report.html").stat().st_size < 5e6
