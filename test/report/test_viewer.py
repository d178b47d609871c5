"""The content of the views, and the page without a browser: it serves, plays, seeks, and rejects bad requests."""

from __future__ import annotations

import contextlib
import dataclasses
import io
import socket
import time
import urllib.request
from base64 import b64decode
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import trimesh
import viser
import yourdfpy
from msgspec import msgpack
from robots import DATA
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

from dqwalk_ros.adopt import adopt
from dqwalk_ros.paper.dual_quaternions import DQ
from dqwalk_ros.paper.foot import Foot
from dqwalk_ros.paper.kinematics import Kinematics
from dqwalk_ros.paper.phase import PhaseKind
from dqwalk_ros.report.html.replay import shape_data
from dqwalk_ros.report.scene import Moments, Scene, beginning, shapes_of
from dqwalk_ros.report.viewer.guard import HOST
from dqwalk_ros.report.viewer.page import Page
from dqwalk_ros.report.viewer.panels import History, margins_html, status_html
from dqwalk_ros.report.viewer.player import Player
from dqwalk_ros.robot.model import load_model
from dqwalk_ros.support.errors import ViewerError


@pytest.fixture(scope="module")
def page():
    page = Page(0)
    yield page
    page.close()


@pytest.fixture(scope="module")
def player(page, trace):
    return Player(page, trace)


def views(trace, count=40):
    scene, moments = Scene(trace.config, trace.model), Moments(trace)
    for tick in np.linspace(0, len(trace) - 1, count).astype(int).tolist():
        yield tick, scene.look(moments.at(tick))


def test_shapes_match_the_urdf(trace):
    shapes = shapes_of(trace.config, trace.model)
    kept = trace.model.urdf.count("<visual>")
    assert len(shapes) == kept > 40  # dropped links are not in the model's URDF
    assert {shape.kind for shape in shapes} == {"box", "cylinder", "sphere"}
    assert {shape.body for shape in shapes} <= set(range(len(trace.model.bodies)))
    urdf = io.BytesIO(trace.model.urdf.encode())
    links = yourdfpy.URDF.load(urdf, load_meshes=False, build_scene_graph=False).robot.links
    visuals = [(trace.model.frames[k.name], v) for k in links if k.name in trace.model.frames for v in k.visuals]
    for shape, (frame, visual) in zip(shapes, visuals, strict=True):
        origin = np.eye(4) if visual.origin is None else visual.origin
        placed = DQ(frame.pose) * DQ.from_matrix(origin[:3, :3], origin[:3, 3])
        point = np.array([0.1, 0.2, 0.3])
        np.testing.assert_allclose(DQ(shape.pose).transform_point(point), placed.transform_point(point), atol=1e-12)
    # the lowest shape is within 3 cm above the ground on which the sole stands
    q = np.zeros(trace.model.n)
    kin = Kinematics(trace.model, q, Foot.LEFT)
    lowest = min(
        float((DQ(kin.pose(name)) * DQ(frame.pose).conj() * DQ(shape.pose)).translation()[2])
        for shape in shapes
        for name, frame in trace.model.frames.items()
        if frame.body == shape.body
    )
    assert -1e-3 < lowest < 0.03


def test_meshes_are_shown(trace, tmp_path):
    """A mesh of the URDF is among the shapes, scaled and placed, with fewer faces, and in the replay."""
    trimesh.creation.icosphere(subdivisions=6, radius=60.0).export(tmp_path / "part.stl")
    mesh = '<geometry><mesh filename="part.stl" scale="0.001 0.001 0.001"/></geometry>'
    look = f'<visual><origin xyz="0 0 0.1"/>{mesh}</visual>'
    lost = '<visual><geometry><mesh filename="lost.stl"/></geometry></visual>'
    text = trace.model.urdf
    end = text.index("</link>", text.index('<link name="pelvis"'))
    (tmp_path / "robot.urdf").write_text(text[:end] + look + lost + text[end:])
    config = trace.config.updated({"robot.urdf": str(tmp_path / "robot.urdf"), "robot.drop": ()})
    (mesh,) = (shape for shape in shapes_of(config, load_model(config.robot)) if shape.kind == "mesh")
    np.testing.assert_allclose(np.linalg.norm(mesh.vertices - [0.0, 0.0, 0.1], axis=1), 0.06, atol=1e-6)
    assert 10_000 < len(mesh.faces) < 60_000
    assert len(b64decode(shape_data(mesh)["f"])) == 4 * mesh.faces.size


def test_views_match_the_walk(trace):
    for tick, view in views(trace):
        index = view.moment.index
        record = trace.phases[index]
        kin = Kinematics(trace.model, trace.q[tick], record.base)
        x = DQ(record.x_odom_base)
        np.testing.assert_allclose(view.com, x.transform_point(kin.com), atol=1e-12)
        np.testing.assert_allclose(view.soles[record.base], record.x_odom_base, atol=1e-12)
        pelvis = list(trace.model.frames).index(trace.model.pelvis)
        assert pelvis == 0
        np.testing.assert_allclose(view.bodies[0], (x * DQ(kin.pose(trace.model.pelvis))).vec8(), atol=1e-12)
        names = {r.name for r in view.regions}
        double = record.kind is PhaseKind.DOUBLE_SUPPORT
        assert names == ({"sliding", "tip_plane", "back_plane", "pelvis"} if double else {"com_cylinder", "pelvis"})
        assert (view.target is None) == double


def test_the_distance_at_the_boundary_of_a_region_is_zero(trace):
    """At the centre of a drawn wall or plane, and on the side of a drawn cylinder."""
    for tick, view in views(trace):
        record, phase = trace.phases[view.moment.index], view.moment.phase
        x = DQ(record.x_odom_base)
        kin = Kinematics(trace.model, trace.q[tick], record.base)
        rows = {row.name: row for row in phase.inequalities}
        for name, region, _ in view.regions:
            row, pose = rows[name], x.conj() * DQ(region.pose)
            if region.kind == "cylinder":
                side = pose.transform_point(np.array([region.size[0], 0.0, 0.0]))
                assert abs(row.evaluate(side)[0]) < 1e-12
            elif region.kind == "plane":
                assert abs(row.evaluate(pose.translation())[0]) < 1e-12
            else:
                a, b = row.fixed, row.moving.value(kin)
                t, v = (b - a)[:2], (pose.translation() - a)[:2]
                assert abs(t[0] * v[1] - t[1] * v[0]) < 1e-12


def test_markers_match_the_shapes_of_the_page(trace):
    """In the frame of the base sole, the shape of each constraint under its name."""
    from dqwalk_ros.nodes.markers import markers

    for tick, view in views(trace, 5):
        phase, model = view.moment.phase, trace.model
        kin = Kinematics(model, trace.q[tick], phase.base)
        clear, *shapes = markers(1_500_000_000, trace.config, model, phase, kin).markers
        assert clear.action == clear.DELETEALL
        found = {marker.ns: marker for marker in shapes}
        regions = {drawn.name: drawn.region for drawn in view.regions}
        target = set() if view.target is None else {"swing_target"}
        others = {"sole/left", "sole/right", "com", "com/projection"} | target
        assert set(found) == set(regions) | others
        assert {marker.header.frame_id for marker in shapes} == {model.soles[phase.base].frame}
        at = {name: np.array([getattr(m.pose.position, axis) for axis in "xyz"]) for name, m in found.items()}
        np.testing.assert_allclose(at["com"], kin.com, atol=1e-12)
        back = DQ(view.moment.x_odom_base).conj()
        for name, region in regions.items():
            np.testing.assert_allclose(at[name], (back * DQ(region.pose)).translation(), atol=1e-12)


def test_gauges_show_the_remaining_distance(trace):
    for tick, view in views(trace):
        phase = view.moment.phase
        kin = Kinematics(trace.model, trace.q[tick], phase.base)
        gauges = {g.name: g for g in view.gauges}
        if phase.kind is PhaseKind.SINGLE_SUPPORT:
            center = trace.model.soles[phase.base].center
            left = trace.config.ssp.com_radius - np.hypot(*(kin.com - center)[:2])
            assert gauges["com_cylinder"].value == pytest.approx(1e3 * left, abs=1e-9)
        low = np.degrees((kin.q - trace.model.q_min).min())
        assert gauges["joint_min"].value == pytest.approx(low, abs=1e-9)


def test_panels_list_every_margin(trace):
    history = History()
    for _, view in views(trace, 60):
        history.add(view)
        text = margins_html(view, history)
        assert text.count("TIGHTEST") == 1
        assert "nan" not in text
        assert "nan" not in status_html(view, total=2, note="")
    for name in ("sliding", "tip_plane", "back_plane", "com_cylinder", "pelvis", "joint_min", "joint_max"):
        assert f'data-curve="{name}"' in text
    assert len(history.marks) == 4


def test_the_panel_says_which_phase_it_is_and_what_happens_in_it(trace):
    _, view = next(views(trace, 60))
    moment = view.moment
    assert (text := status_html(view, total=4, note="")).count("1 of 4") == 1
    assert "the CoM moves over the left foot" in text
    standing = dataclasses.replace(moment.phase, kind=PhaseKind.STANCE)
    text = status_html(dataclasses.replace(view, moment=dataclasses.replace(moment, phase=standing)), total=0, note="")
    assert "the CoM stays between the feet" in text
    assert " of " not in text


def test_the_history_is_bounded_and_covers_the_whole_walk(trace):
    _, view = next(views(trace, 1))
    history = History()
    moment = view.moment
    for k in range(20_000):
        object.__setattr__(moment, "time", 0.005 * k)
        history.add(view)
    assert len(history.times) < 1000
    assert history.times[0] == 0.0
    assert history.times[-1] > 99.0
    assert max(np.diff(history.times)) < 1.0


def test_curves_begin_anew_with_a_new_walk(trace):
    page = Page(0)
    try:
        page.set_scene(Scene(trace.config, trace.model))
        moments = Moments(trace)
        for tick in (0, 100, len(trace) - 1):
            page.show(moments.at(tick))
        assert page.history.times == trace.time[[0, 100, -1]].tolist()
        page.show(moments.at(50))
        assert page.history.times == [trace.time[50]]
    finally:
        page.close()


def test_the_page_serves_and_plays(page, player):
    assert page.url.startswith(f"http://{HOST}:")
    with urllib.request.urlopen(page.url, timeout=10) as answer:
        assert b"<html" in answer.read().lower()
    before, end = page.shown, time.monotonic() + 20.0
    player.toggle()
    player.run(lambda: page.shown <= before + 5 and time.monotonic() < end)
    assert page.shown > before + 5
    player.toggle()
    player.seek(1e9)
    player.show()
    assert "finished" in page._status.content
    player.seek(-1.0)
    player.show()
    assert "double support" in page._status.content


@pytest.mark.parametrize(
    ("host", "origin", "allowed"),
    [
        ("127.0.0.1:{port}", None, True),
        ("localhost:9000", "http://localhost:9000", True),  # through a tunnel
        ("127.0.0.1:{port}", "http://127.0.0.1:{port}", True),
        ("127.0.0.1:{port}", "https://evil.example", False),
        ("evil.example:{port}", "https://evil.example", False),  # DNS rebinding
        ("evil.example:{port}", None, False),
        ("127.0.0.1:{port}", "null", False),
        ("[::1", None, False),
    ],
)
def test_requests_of_foreign_pages_are_rejected(page, host, origin, allowed):
    port = page.server.get_port()
    lines = ["GET / HTTP/1.1", f"Host: {host.format(port=port)}", "Upgrade: websocket", "Connection: Upgrade"]
    lines += ["Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==", "Sec-WebSocket-Version: 13"]
    lines += ["Sec-WebSocket-Protocol: viser-v" + viser.__version__]
    lines += [f"Origin: {origin.format(port=port)}"] if origin else []
    with socket.create_connection((HOST, port), timeout=10.0) as connection:
        connection.sendall("\r\n".join([*lines, "", ""]).encode())
        status = connection.recv(64).decode().split()[1]
    assert status == ("101" if allowed else "403")


def test_messages_that_no_control_sends_have_no_effect(page, player, monkeypatch, capfd):
    """None publishes the page on the internet, changes more of a control than its value, or fills the log."""
    shared = []
    monkeypatch.setattr(page.server, "request_share_url", lambda *_: shared.append(1))
    control, speed = player._speed, player._speed._impl

    def update(**values):
        return {"type": "GuiUpdateMessage", "uuid": speed.uuid, "updates": values}

    foreign = [{"type": "ShareUrlRequest"}, update(sync_cb=3), update(value=None), {"type": "Unknown"}, [1], update()]
    foreign += [update(value="9", sync_cb=3), update(value="9") | {"more": 1}]
    ignored = [*map(msgpack.encode, foreign), b"\xc1", "text", b"\x91" * 60_000]
    camera = msgpack.encode({"type": "ViewerCameraMessage", "wxyz": "abc"})  # viser raises an error
    url = page.url.replace("http", "ws")
    for message in (*ignored, b"a" * 2**17, camera):
        with connect(url, subprotocols=["viser-v" + viser.__version__], compression=None) as browser:
            before, end = control.value, time.monotonic() + 20.0
            browser.send(message)
            with contextlib.suppress(ConnectionClosed):
                browser.send(msgpack.encode(update(value="5" if before != "5" else "2")))
            while control.value == before and time.monotonic() < end and not browser.protocol.close_rcvd:
                time.sleep(0.005)
            assert (control.value != before) == (message in ignored)
    assert control.value in ("2", "5")
    assert not shared
    assert callable(speed.sync_cb)
    assert capfd.readouterr().err.count("\n") <= 2


def clicks(page, offer):
    """Return the function that viser calls when a button is clicked, of the controls that `offer` adds."""
    buttons = {}
    gui = page.server.gui
    added = gui.add_button_group
    gui.add_button_group = lambda *words: buttons.setdefault("to", added(*words))
    try:
        offer()
    finally:
        del gui.add_button_group
    (clicked,) = buttons["to"]._impl.update_cb
    return lambda value: clicked(SimpleNamespace(client=object(), target=SimpleNamespace(value=value)))


def test_the_push_buttons_apply_pushes(page):
    pushes: list[list[float]] = []
    page._push = None
    click = clicks(page, lambda: page.offer_push(lambda impulse: pushes.append(impulse.tolist()), 0.3))
    for value in ("left", "back", "elsewhere", None, [1]):
        click(value)
    assert pushes == [[0.0, 0.3, 0.0], [-0.3, 0.0, 0.0]]


def test_the_steering_buttons_give_velocities(page):
    given: list[list[float]] = []
    fastest = np.array([0.1, 0.0, 0.2])
    click = clicks(page, lambda: page.offer_steering(lambda velocity: given.append(velocity.tolist()), fastest))
    for value in ("ahead", "turn right", "stop", "elsewhere", None, [1]):
        click(value)
    np.testing.assert_allclose(given, [[0.07, 0.0, 0.0], [0.0, 0.0, -0.14], [0.0, 0.0, 0.0]], atol=1e-15)


def test_the_divergent_component_is_ahead_of_the_com_by_its_velocity(trace):
    """By v/w with w^2 = g/h; at rest it is above the centre of mass."""
    scene, moment = Scene(trace.config, trace.model), Moments(trace).at(200)
    view = scene.look(moment)
    still = scene.look(replace(moment, dq=np.zeros_like(moment.q)))
    np.testing.assert_allclose(still.divergent[:2], view.com[:2], atol=1e-6)
    dt = 1e-6
    later = scene.look(replace(moment, q=moment.q + dt * moment.dq))
    v = (later.com - view.com)[:2] / dt
    assert np.linalg.norm(v) > 1e-4
    np.testing.assert_allclose(view.divergent[:2], view.com[:2] + v * np.sqrt(view.com[2] / 9.80665), atol=1e-6)
    assert scene.look(Moments(trace).at(0)).divergent is None


def test_control_values_of_a_wrong_type_are_ignored(page, player, trace):
    """A browser can send any value; the replay continues."""
    for value in ("abc", float("nan"), 1e308, None, [1], {}):
        player._on_slider(SimpleNamespace(client=object(), target=SimpleNamespace(value=value)))
        player._on_jump(value)
        assert trace.time[0] <= player._at <= trace.time[-1]
        player._speed = SimpleNamespace(value=value)
        player.toggle()
        pictures, end = page.shown, time.monotonic() + 20.0
        player.run(lambda pictures=pictures, end=end: page.shown == pictures and time.monotonic() < end)
        assert page.shown > pictures, value
        player.toggle()


def test_bag_names_are_escaped(page):
    page.say("reading <img src=x onerror=alert(3)>")
    assert "<img" not in page._status.content


def test_the_page_listens_on_this_machine_only(trace):
    page = Page(0)
    try:
        port = int(page.url.rpartition(":")[2])
        for address in {info[4][0] for info in socket.getaddrinfo(socket.gethostname(), None, socket.AF_INET)} - {HOST}:
            with socket.socket() as probe:
                probe.settimeout(0.5)
                assert probe.connect_ex((address, port)) != 0
        with pytest.raises(ViewerError, match="ports are 0 to 65535"):
            Page(99_999)
        with pytest.raises(ViewerError, match=r"port \d+ is in use.*--port"):
            Page(port)
    finally:
        page.close()


@pytest.mark.long
def test_an_adopted_robot_is_shown_in_its_standing_posture(tmp_path):
    """Both soles on the ground side by side, the CoM above their midpoint, from which an arrow points forward."""
    found = adopt(DATA / "small_humanoid.urdf", tmp_path)
    page = Page(0)
    try:
        page.set_scene(Scene(found.config, found.model))
        view = page.show(beginning(found.config, found.model), force=True)
        page.point_ahead(view)
        left, right = (DQ(view.soles[foot]).translation() for foot in Foot)
        assert left[2] == pytest.approx(right[2], abs=1e-3)
        np.testing.assert_allclose(view.com[:2], 0.5 * (left + right)[:2], atol=2e-3)
        ((begin, end),) = page.server.scene.get_handle_by_name("/ahead").points
        np.testing.assert_allclose(begin[:2], 0.5 * (left + right)[:2], atol=1e-3)
        assert end[0] - begin[0] == pytest.approx(0.5 * (view.com[2] - view.ground), rel=1e-3)
        assert abs(end[1] - begin[1]) < 1e-3
        assert "double support" in page._status.content
    finally:
        page.close()
