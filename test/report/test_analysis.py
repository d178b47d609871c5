"""The report compared with independent computations, its violations for modified walks, and the figures."""

from __future__ import annotations

import dataclasses
import json

import numpy as np
import pytest
from recorded import part, repeated

from dqwalk_ros import KinematicPlant, load, load_model, make_controller, simulate
from dqwalk_ros import report as reporting
from dqwalk_ros.paper.dual_quaternions import DQ
from dqwalk_ros.paper.foot import Foot
from dqwalk_ros.paper.geometry import ConvexPolygon
from dqwalk_ros.paper.kinematics import Kinematics
from dqwalk_ros.report.figures import drawn, figure7, figure8, figure9, top_view
from dqwalk_ros.report.table import numbers

RED = "#d1242f"


@pytest.fixture(scope="module")
def series(trace):
    return reporting.analyse(trace)


@pytest.fixture(scope="module")
def report(series):
    return reporting.report(series)


def modified_report(trace, **changes):
    return reporting.report(reporting.analyse(dataclasses.replace(trace, **changes)))


def names(report):
    return {violation["what"] for violation in report["violations"]}


# ---------------------------------------------------------------------- series


def test_spans_match_the_recorded_phases(trace, series):
    assert [span.phase.name for span in series.spans] == [record.name for record in trace.phases]
    assert [span.start for span in series.spans] == [record.start for record in trace.phases]
    assert series.spans[-1].end == len(trace.time)
    np.testing.assert_array_equal(np.unique(series.span_of), range(len(trace.phases)))


def test_series_match_the_phase_at_each_tick(trace, series):
    """The series against `Phase.distances` and `Evaluation.error`."""
    rng = np.random.default_rng(5)
    for span in series.spans:
        for tick in (span.start, *rng.integers(span.start, span.end, 30), span.end - 1):
            kin = Kinematics(trace.model, trace.q[tick], span.phase.base)
            assert series.error[tick] == pytest.approx(span.phase.evaluate(kin.q).error, abs=1e-14)
            np.testing.assert_allclose(series.com[tick], kin.com, rtol=0, atol=1e-15)
            for name, value in span.phase.distances(kin.q).items():
                assert (series.distances | series.residuals)[name][tick] == pytest.approx(value, abs=1e-14), name


def test_distances_are_nan_outside_their_phase(series):
    sliding, cylinder = series.distances["tip_plane"], series.distances["com_cylinder"]
    for span in series.spans:
        assert np.isfinite(sliding[span.ticks]).all() == span.double
        assert np.isfinite(cylinder[span.ticks]).all() == (not span.double)


def test_heights_and_distances_match_independent_computation(trace, series):
    """Each recomputed from the poses of links, independently of the series."""
    rng = np.random.default_rng(0)
    model = trace.model
    for tick in rng.integers(0, len(trace.time), 20):
        span = series.spans[series.span_of[tick]]
        kin = Kinematics(model, trace.q[tick], span.phase.base)
        sole, base = model.soles[span.phase.base.other], model.soles[span.phase.base]
        tip = DQ(kin.pose(sole.frame)).transform_point(sole.tip)
        assert series.tip_height[tick] == pytest.approx(tip[2], abs=1e-12)
        assert series.pelvis[tick, 2] == pytest.approx(DQ(kin.pose(model.pelvis)).translation()[2], abs=1e-12)
        if span.double:
            start = Kinematics(model, span.record.q_start, span.phase.base)
            moved = tip - DQ(start.pose(sole.frame)).transform_point(sole.tip)
            assert series.slide[tick] == pytest.approx(np.hypot(*moved[:2]), abs=1e-12)
            center = DQ(kin.pose(sole.frame)).transform_point(sole.center)
            assert series.error[tick] == pytest.approx(np.hypot(*(kin.com - center)[:2]), abs=1e-12)
            assert series.com_to_axis[tick] == pytest.approx(series.error[tick], abs=1e-12)
        else:
            assert np.isnan(series.slide[tick])
            x, target = kin.pose(sole.frame), span.record.swing_target
            assert series.error[tick] == pytest.approx(
                min(np.linalg.norm(x - target), np.linalg.norm(x + target)), abs=1e-12
            )
            off = kin.com - base.center
            assert series.com_to_axis[tick] == pytest.approx(np.hypot(*off[:2]), abs=1e-12)
            inside = min(0.5 * base.length - abs(off[0]), 0.5 * base.width - abs(off[1]))
            if inside > 0.0:
                assert series.true_margin[tick] == pytest.approx(inside, abs=1e-12)
            else:
                assert series.true_margin[tick] < 0.0


def test_paper_margin_is_the_smallest_distance(trace, series):
    for span in series.spans:
        if span.double:
            planes = np.minimum(series.distances["tip_plane"], series.distances["back_plane"])
            np.testing.assert_array_equal(series.paper_margin[span.ticks], planes[span.ticks])
        else:
            # (14) is squared: r^2 - d^2 = (r - d) (r + d)
            r, margin = trace.config.ssp.com_radius, series.paper_margin[span.ticks]
            squared = margin * (2.0 * r - margin)
            np.testing.assert_allclose(series.distances["com_cylinder"][span.ticks], squared, atol=1e-12)


def test_the_com_is_continuous_in_odom(series):
    step = np.linalg.norm(np.diff(series.com_odom, axis=0), axis=1)
    assert step.max() < 0.04 * series.trace.config.dt


def test_true_margin_in_double_support_uses_the_convex_hull(series):
    """It is never less than the margin of either sole alone."""
    trace = series.trace
    for span in (span for span in series.spans if span.double):
        for tick in (span.start, span.end - 1):
            base, other = (trace.model.soles[foot].corners for foot in (span.phase.base, span.phase.base.other))
            there = DQ(series.end[tick]).transform_point(other)
            alone = [ConvexPolygon.hull(corners).distance(series.com[tick]) for corners in (base, there)]
            assert series.true_margin[tick] >= max(alone) - 1e-12
    assert trace.model.soles[Foot.LEFT].length == pytest.approx(0.0934)
    assert series.urdf_margin is not None  # the sole of paper.yaml differs from the one of the URDF


# ---------------------------------------------------------------------- report


def test_a_walk_without_violations_is_ok(report):
    assert report["violations"] == []
    assert report["ok"] is True


def test_the_report_is_valid_json(report):
    assert json.loads(json.dumps(report, allow_nan=False)) == report


def test_report_values_of_the_phases(trace, series, report):
    assert len(report["phases"]) == len(trace.phases) == 4
    ends = [record.time for record in trace.phases[1:]] + [trace.time[-1]]
    for phase, record, span, end in zip(report["phases"], trace.phases, series.spans, ends, strict=True):
        assert phase["name"] == record.name
        assert (phase["start"], phase["end"]) == (record.time, pytest.approx(end))
        assert phase["ticks"] == span.end - span.start
        assert phase["ended"] is True
        assert phase["error"]["first"] == series.error[span.start]
        for name, least in phase["minimum"].items():
            values = series.distances[name][span.ticks]
            assert least["value"] == np.nanmin(values)
            at = np.searchsorted(trace.time, least["time"])
            assert series.distances[name][at] == least["value"]
        assert phase["worst"]["value"] == min(least["value"] for least in phase["minimum"].values())
        assert phase["worst"]["violation"] == max(0.0, -phase["worst"]["value"])
    assert report["phases"][1]["error"]["last"] < trace.config.ssp.threshold


def test_landing_error_matches_independent_computation(trace, report):
    """Computed from the first state of the next phase."""
    record, following = trace.phases[1], trace.phases[2]
    frame = trace.model.soles[record.base.other].frame
    x = DQ(Kinematics(trace.model, following.q_start, record.base).pose(frame)).translation()
    wanted = DQ(record.swing_target).translation()
    landing = report["phases"][1]["landing"]
    np.testing.assert_allclose([landing["x"], landing["y"], landing["z"]], x, atol=1e-15)
    assert landing["error"] == pytest.approx(np.linalg.norm(x - wanted), abs=1e-12)
    assert abs(landing["x"] - trace.config.gait.step_length) < 2.1 * trace.config.ssp.threshold


def test_report_values_of_the_walk(trace, series, report):
    walk = report["walk"]
    assert walk["steps"] == 2
    assert walk["ticks"] == len(trace.time)
    assert walk["finished"] is True
    assert walk["landing_error"] == max(phase["landing"]["error"] for phase in report["phases"] if "landing" in phase)
    margin = np.minimum(trace.q - trace.model.q_min, trace.model.q_max - trace.q)
    assert walk["margin"]["joints"]["value"] == margin.min()
    assert walk["closest_joint"] == trace.model.joint_names[np.argmin(margin.min(axis=0))]
    assert walk["joint_speed"]["largest"] == np.abs(trace.u).max()
    assert walk["unit_norm_error"] < 1e-12
    assert walk["margin"]["paper"]["value"] == series.paper_margin.min()
    assert walk["margin"]["true"]["value"] == series.true_margin.min()
    assert walk["margin"]["true_urdf_sole"]["value"] == series.urdf_margin.min()


def test_the_step_that_puts_the_feet_together_is_counted_apart(report):
    assert dict(numbers(report))["steps"].startswith("2, ")
    stood = {"config": report["config"] | {"gait.steps": 1}, "walk": report["walk"] | {"style": "standing"}}
    assert dict(numbers(report | stood))["steps"].startswith("1 and 1 that puts the feet together, ")


def test_walked_distance_matches_independent_computation(trace, report):
    """Distance between the midpoints of the feet at the start and at the end."""
    model, ends = trace.model, []
    for record, q in ((trace.phases[0], trace.q[0]), (trace.phases[-1], trace.q[-1])):
        feet = []
        for foot in Foot:
            frame = model.soles[foot].frame
            x = DQ(record.x_odom_base) * DQ(Kinematics(model, q, record.base).pose(frame))
            feet.append(x.transform_point(model.soles[foot].center)[:2])
        ends.append(np.mean(feet, axis=0))
    assert report["walk"]["distance"] == pytest.approx(np.linalg.norm(ends[1] - ends[0]), abs=1e-12)
    assert report["walk"]["forward"] == pytest.approx(ends[1][0] - ends[0][0], abs=1e-12)


def test_solve_times(trace):
    known = np.linspace(1e-5, 1e-4, len(trace.time))
    assert modified_report(trace, solve_time=known)["solve_time"]["max"] == 1e-4
    assert modified_report(trace, solve_time=np.full(len(trace.time), np.nan))["solve_time"] is None


def test_report_of_an_unfinished_walk(trace, report):
    """The recorded part is evaluated; the only violation is that the walk did not finish."""
    stopped = modified_report(part(trace, slice(trace.phases[2].start - 50), trace.phases[:2]))
    assert stopped["ok"] is False
    (violation,) = stopped["violations"]
    assert violation["what"] == "finished"
    assert "single_support/left" in violation["message"]
    assert "OK: " not in reporting.render(stopped)
    assert stopped["walk"]["finished"] is False
    assert stopped["walk"]["steps"] == 0
    assert stopped["walk"]["landing_error"] is None
    assert [phase["ended"] for phase in stopped["phases"]] == [True, False]
    assert "landing" not in stopped["phases"][1]
    assert stopped["phases"][0] == report["phases"][0]


def test_states_without_a_command(trace):
    u = trace.u.copy()
    u[100:110] = np.nan
    assert modified_report(trace, u=u)["walk"]["unanswered"] == 10
    assert modified_report(trace, u=np.full_like(u, np.nan))["walk"]["joint_speed"]["largest"] == 0.0


def test_the_table_contains_phases_and_margins(report):
    text = reporting.render(report)
    for phase in report["phases"]:
        assert phase["name"] in text
    for what in (
        "com_cylinder",
        "tip_plane",
        "paper margin",
        "true margin",
        "URDF's own sole",
        "landing error",
        "OK: ",
    ):
        assert what in text
    assert max(map(len, text.splitlines())) < 160


def test_the_report_says_how_close_each_row_came_to_its_sampled_bound(trace, series, report):
    """Of the sliding foot, computed here from its distances: (1 - eta dt) d less the curvature."""
    bounds, config = report["walk"]["bounds"], trace.config
    assert set(bounds) == set(series.distances)
    assert all(one["spare"]["value"] > -1e-9 for one in bounds.values())
    spares = {}
    for record, ticks in zip(trace.phases, trace.spans, strict=True):
        radius = Kinematics(trace.model, record.q_start, record.base).com[2]
        for k in ticks[:-1]:
            now, after = series.distances["sliding"][[k, k + 1]]
            turned = np.abs(trace.q[k + 1] - trace.q[k]).sum()
            allowed = (1.0 - config.dsp.eta_sliding * config.dt) * now - 0.5 * radius * turned**2
            spares[k + 1] = (after - allowed) / config.dt
    tick = min(spares, key=lambda k: np.nan_to_num(spares[k], nan=np.inf))
    least = bounds["sliding"]["spare"]
    assert least == pytest.approx({"value": spares[tick], "time": trace.time[tick], "tick": tick}, abs=1e-9)
    assert f"{least['value']:.4g}" in reporting.render(report)
    q = trace.q.copy()
    q[40, trace.model.joint_names.index("l_knee_y")] += 0.05
    jump = modified_report(trace, q=q)["walk"]["bounds"]["joint_min"]["spare"]  # as it turns back, faster than allowed
    assert jump["tick"] == 41
    assert jump["value"] < 0.0


# ---------------------------------------------------------------------- violations


def test_a_joint_beyond_its_limit_is_a_violation(trace):
    q = trace.q.copy()
    tick, joint = 500, trace.model.joint_names.index("l_knee_y")
    q[tick, joint] = trace.model.q_min[joint] - 1e-3
    report = modified_report(trace, q=q)
    assert report["ok"] is False
    assert {"joint/l_knee_y", "joint_min"} <= names(report)
    (found,) = [v for v in report["violations"] if v["what"] == "joint/l_knee_y"]
    assert found["value"] == pytest.approx(-1e-3, abs=1e-12)
    assert found["time"] == trace.time[tick]
    assert "l_knee_y" in found["message"]
    assert "NOT OK" in reporting.render(report)


def test_values_within_the_tolerance_are_no_violation(trace):
    q = trace.q.copy()
    joint = trace.model.joint_names.index("l_knee_y")
    q[-1, joint] = trace.model.q_min[joint] - 0.9e-5
    assert not {"joint/l_knee_y", "joint_min"} & names(modified_report(trace, q=q))


def test_a_foot_off_the_ground_is_a_violation(trace):
    """About 0.5 mm, late in double support."""
    first, second = trace.phases[0], trace.phases[1]
    q = trace.q.copy()
    ankle = trace.model.joint_names.index(f"{first.base.other.value[0]}_ankle_y")
    q[second.start - 20 : second.start - 10, ankle] -= 0.01
    assert "ground" in names(modified_report(trace, q=q))


def test_a_distance_that_decreases_too_fast_is_a_violation(trace):
    """A jump of the CoM inside all bounds violates the rate that eta allows."""
    q = trace.q.copy()
    tick = trace.phases[0].start + 40
    q[tick, [trace.model.joint_names.index(f"{side}_hip_x") for side in "lr"]] += [0.05, 0.05]
    what = names(modified_report(trace, q=q))
    assert any(name.startswith("eta/") for name in what)
    assert not what & {"tip_plane", "back_plane", "pelvis", "joint_min", "joint_max"}


def test_a_wrong_landing_position_is_a_violation(trace):
    records = list(trace.phases)
    target = DQ(records[1].swing_target) * DQ.from_pose([0.0, 0.02, 0.0])
    records[1] = dataclasses.replace(records[1], swing_target=target.vec8())
    assert {"landing", "end/error"} <= names(modified_report(trace, phases=tuple(records)))


def test_the_com_outside_its_cylinder_is_a_violation(trace):
    """The same walk evaluated with a smaller cylinder."""
    config = trace.config.updated({"ssp.com_radius": 0.02})
    what = names(modified_report(trace, config=config))
    assert {"com_cylinder", "end/cylinder"} <= what


def test_a_pose_without_unit_norm_is_a_violation(trace):
    records = list(trace.phases)
    records[2] = dataclasses.replace(records[2], x_odom_base=records[2].x_odom_base * (1.0 + 1e-9))
    assert "unit_norm" in names(modified_report(trace, phases=tuple(records)))


# ---------------------------------------------------------------------- figures


def lines_of(ax, dashed):
    from matplotlib.colors import to_hex

    return [line for line in ax.get_lines() if (to_hex(line.get_color()) == RED) == dashed]


def test_figure7_has_the_papers_panels(trace, series):
    axes = figure7(series).get_axes()
    assert [ax.get_title(loc="left")[0] for ax in axes] == list("ABCDEF")
    for ax in axes:
        assert len(lines_of(ax, dashed=False)) == 2  # two double supports
        assert ax.get_ylabel().endswith("[mm]")
    bounds = [[line.get_ydata()[0] for line in lines_of(ax, dashed=True)] for ax in axes]
    assert bounds == [[50.0], [40.0], [], [0.0], [0.0], [0.0]]
    for ax in axes:
        for line in lines_of(ax, dashed=True):
            assert line.get_linestyle() == "--"


def test_figure7_shows_the_series(series):
    """The first curve is on top, blue, the second green; the minimum and the maximum are drawn."""
    from matplotlib.colors import to_hex

    ax = figure7(series).get_axes()[3]
    first, second = (span for span in series.spans if span.double)
    green, blue = lines_of(ax, dashed=False)
    assert (to_hex(blue.get_color()), to_hex(green.get_color())) == ("#1f5fb4", "#1d9a4e")
    for line, span in ((blue, first), (green, second)):
        values = 1e3 * series.distances["tip_plane"][span.ticks]
        assert line.get_ydata().min() == values.min()
        assert line.get_ydata().max() == values.max()
        assert line.get_xdata()[0] == 0.0


def test_figure8_has_the_papers_panels(trace, series):
    axes = figure8(series).get_axes()
    assert [ax.get_title(loc="left")[0] for ax in axes] == list("ABC")
    assert all(len(lines_of(ax, dashed=False)) == 2 for ax in axes)
    bounds = [lines_of(ax, dashed=True)[0].get_ydata()[0] for ax in axes]
    assert bounds == [trace.config.ssp.threshold, 50.0, 0.0]


def test_figure9_shows_joints_limits_and_phase_changes(trace, series):
    from matplotlib.collections import LineCollection

    model = trace.model
    axes = figure9(series).get_axes()
    assert len(axes) == model.n
    limits = {tuple(np.degrees([low, high]).round(6)) for low, high in zip(model.q_min, model.q_max, strict=True)}
    changes = [record.time for record in trace.phases[1:]]
    for ax in axes:
        drawn = tuple(sorted(line.get_ydata()[0] for line in lines_of(ax, dashed=True)))
        assert tuple(np.round(drawn, 6)) in limits
        (marks,) = (lines for lines in ax.collections if isinstance(lines, LineCollection))
        assert [segment[:, 0].tolist() for segment in marks.get_segments()] == [[at, at] for at in changes]


def test_the_last_joint_of_either_column_has_a_time_axis():
    config = load("paper").updated({"robot.drop": ["abs_x"]})  # an eleventh joint, in the left column
    model = load_model(config.robot)
    figure = figure9(reporting.analyse(simulate(make_controller(config, model), KinematicPlant(model), max_time=0.05)))
    labelled = [(bool(ax.get_xlabel()), ax.xaxis.get_tick_params()["labelbottom"]) for ax in figure.get_axes()]
    assert labelled == 9 * [(False, False)] + 2 * [(True, True)]


def test_top_view_shows_soles_cylinders_and_margins(trace, series):
    from matplotlib.collections import PatchCollection

    ground, margins = top_view(series).get_axes()
    circles = [path for drawn in ground.collections if isinstance(drawn, PatchCollection) for path in drawn.get_paths()]
    assert [0.5 * circle.get_extents().width for circle in circles] == pytest.approx([0.05, 0.05])
    assert sorted(text.get_text() for text in ground.texts) == ["1", "2"]
    assert all(text.get_path_effects() for text in ground.texts)  # readable on an edge
    assert margins.get_legend().get_frame_on()  # readable above the marks of the phases
    assert len(margins.get_legend().get_texts()) == 3


def test_later_cycles_are_drawn_lighter(trace):
    """Two cycles: four curves, with lighter colours in the second cycle."""
    from matplotlib.colors import rgb_to_hsv, to_rgb

    ax = figure7(reporting.analyse(repeated(trace, 2))).get_axes()[0]
    curves = lines_of(ax, dashed=False)[::-1]
    assert len(curves) == 4
    shade = [rgb_to_hsv(to_rgb(line.get_color()))[1] for line in curves]
    assert shade[2] < 0.6 * shade[0]
    assert shade[3] < 0.6 * shade[1]


@pytest.mark.long
def test_figures_of_many_phases_have_few_parts(trace):
    """Of 120 phases: curves in ten tones of both colours, the last numbers, and no marks over time."""
    series = reporting.analyse(repeated(trace, 30))
    assert len(lines_of(figure7(series).get_axes()[0], dashed=False)) == 20
    ground, margins = top_view(series).get_axes()
    assert [text.get_text() for text in ground.texts] == ["60", "59"]  # the feet step on one place again and again
    assert not margins.collections


def test_figures_are_saved_in_every_format(series, tmp_path, monkeypatch):
    from matplotlib.image import imread

    monkeypatch.setattr("dqwalk_ros.report.figures.FIGURES", {"figure8": (figure8, "")})
    files = reporting.save(series, tmp_path / "new" / "folder", ("png", "pdf", "svg"))
    assert [file.name for file in files] == ["figure8.png", "figure8.pdf", "figure8.svg"]
    assert files[0].read_bytes()[:4] == b"\x89PNG"
    assert files[1].read_bytes()[:4] == b"%PDF"
    assert "<svg" in files[2].read_text()
    assert "Pose error of the swing foot" in files[2].read_text()  # text is not converted to paths
    picture = imread(files[0])
    assert picture.shape[1] > 1600
    assert 0.02 < (picture[..., :3].min(axis=2) < 0.9).mean() < 0.5  # neither blank nor black


@pytest.mark.parametrize("n", [1, 40])
def test_figures_of_a_walk_that_ends_in_its_first_phase(trace, n):
    series = reporting.analyse(part(trace, slice(n), trace.phases[:1]))
    assert names(reporting.report(series)) == {"finished"}
    assert all(figure.get_axes() for _, figure, _ in drawn(series))


def test_report_and_figures_of_a_single_support_phase_only(trace):
    """A recording that starts late and ends early."""
    record, end = trace.phases[1], trace.phases[2].start
    phases = [dataclasses.replace(record, start=0)]
    series = reporting.analyse(part(trace, slice(record.start, end), phases))
    report = reporting.report(series)
    assert names(report) == {"finished"}
    assert "single_support/left (stopped)" in reporting.render(report)
    assert all(figure.get_axes() for _, figure, _ in drawn(series))


def test_a_walk_that_is_given_by_its_class_is_judged_as_what_it_extends():
    """It has no `gait.style` of its own; by the default the report looked for the planes of the paper, and crashed."""
    own = "dqwalk_ros.walks.standing.walk:StandingWalk"
    config = load("poppy").updated({"gait.style": "paper", "gait.walk": own, "gait.steps": 1})
    model = load_model(config.robot)
    walked = simulate(make_controller(config, model), KinematicPlant(model, model.posture(config.standing.posture)))
    series = reporting.analyse(walked)
    report = reporting.report(series)
    assert report["ok"], report["violations"]
    assert report["walk"]["style"] == "standing"
    assert "paper" not in report["walk"]["margin"]
    assert "1 and 1 that puts the feet together" in reporting.render(report)
    assert {one.name for one in drawn(series)} == {"top_view", "figure9"}
