"""Bags: exact round trips, bags of other programs, damaged bags, and errors for unusable bags."""

from __future__ import annotations

import dataclasses
import shutil
from pathlib import Path

import numpy as np
import pytest
import yaml
from mcap.reader import make_reader
from recorded import rewrite
from rosbags.rosbag2 import CompressionFormat, CompressionMode, Reader, StoragePlugin, Writer

from dqwalk_ros.paper.dual_quaternions import DQ
from dqwalk_ros.report import bag
from dqwalk_ros.report.bag import messages, storage
from dqwalk_ros.support.errors import BagError
from dqwalk_ros.support.topics import FINISHED, OPTIONAL, TOPICS


@pytest.fixture(scope="module")
def plain(trace, tmp_path_factory):
    """The same bag as written by another program: not compressed, and without diagnostics."""
    packed, path = (tmp_path_factory.mktemp(name) / "walk" for name in ("packed", "plain"))
    bag.write(trace, packed, diagnostics=False)
    return rewrite(packed, path)


def assert_same(one, other, upto=None):
    """Angles and velocities are bitwise equal, times within the resolution of a stamp (1 ns), poses within 1 ulp."""
    np.testing.assert_allclose(other.time[:upto], one.time[:upto], rtol=0, atol=1e-12)
    for name in ("q", "u"):
        np.testing.assert_array_equal(getattr(one, name)[:upto], getattr(other, name)[:upto], err_msg=name)
    for a, b in zip(one.phases, other.phases, strict=upto is None):
        for name in ("name", "kind", "support", "base", "start"):
            assert getattr(a, name) == getattr(b, name), name
        assert b.time == pytest.approx(a.time, rel=0, abs=1e-12)
        np.testing.assert_array_equal(a.q_start, b.q_start)
        np.testing.assert_allclose(b.x_odom_base, a.x_odom_base, rtol=0, atol=1e-15)
        assert (a.swing_target is None) == (b.swing_target is None)
        if a.swing_target is not None:
            np.testing.assert_allclose(b.swing_target, a.swing_target, rtol=0, atol=1e-15)


# ---------------------------------------------------------------------- written bags


@pytest.mark.parametrize("kind", list(StoragePlugin))
def test_round_trip_is_exact(trace, path, tmp_path, kind):
    back = bag.read(rewrite(path, tmp_path / "walk", storage=kind))
    assert_same(trace, back)
    assert back.config == trace.config
    assert back.model.joint_names == trace.model.joint_names
    assert back.model.urdf == trace.model.urdf
    assert back.finished is trace.finished is True
    assert back.notes == ()


def test_content_is_loaded_once(trace, path):
    content = bag.content_of(path)
    assert bag.content_of(content) is content
    assert not bag.is_body(content)
    assert_same(trace, bag.read(content))


def test_rewriting_a_bag_preserves_the_walk(trace, path, tmp_path):
    again = bag.read(path)
    bag.write(again, tmp_path / "walk", diagnostics=False)
    assert_same(trace, bag.read(tmp_path / "walk"))
    np.testing.assert_array_equal(bag.read(tmp_path / "walk").time, again.time)


def test_a_decision_may_contain_a_slash(trace, tmp_path):
    """That of one's own walk; it was taken for the name of a phase."""
    first, *others = trace.phases
    decided = dataclasses.replace(trace, phases=(dataclasses.replace(first, decision="1/2 of it has arrived"), *others))
    bag.write(decided, tmp_path / "walk", diagnostics=False)
    back = bag.read(tmp_path / "walk")
    assert_same(trace, back)
    assert back.notes == ()
    assert [phase.decision for phase in back.phases] == [phase.decision for phase in decided.phases]


def test_numbers_of_all_magnitudes_are_preserved(trace, tmp_path):
    rng = np.random.default_rng(1)
    u = rng.normal(size=trace.u.shape) * 10.0 ** rng.integers(-300, 300, trace.u.shape)
    u[0, 0], u[0, 1] = -0.0, 5e-324
    bag.write(dataclasses.replace(trace, u=u), tmp_path / "walk", diagnostics=False)
    back = bag.read(tmp_path / "walk").u
    np.testing.assert_array_equal(back.view(np.int64), u.view(np.int64))


def test_the_bag_is_a_valid_rosbag2(path, trace):
    meta = yaml.safe_load((path / "metadata.yaml").read_text())["rosbag2_bagfile_information"]
    assert meta["version"] == 9
    assert meta["storage_identifier"] == "mcap"
    assert meta["starting_time"]["nanoseconds_since_epoch"] == round(trace.time[0] * 1e9)
    assert meta["duration"]["nanoseconds"] == round((trace.time[-1] - trace.time[0]) * 1e9)
    topics = {t["topic_metadata"]["name"]: t for t in meta["topics_with_message_count"]}
    said = {name: topic for name, topic in TOPICS.items() if topic.source not in OPTIONAL}
    assert set(topics) == {"/" + name for name in said}
    assert topics["/joint_states"]["message_count"] == len(trace.time)
    for name, topic in said.items():
        info = topics["/" + name]["topic_metadata"]
        assert info["type"] == topic.type
        assert info["type_description_hash"].startswith("RIHS01_")
        (qos,) = info["offered_qos_profiles"]
        assert qos["reliability"] == "reliable"
        assert qos["durability"] == ("transient_local" if topic.latched else "volatile")
        assert qos["depth"] == topic.depth


def test_message_definitions_are_embedded(path):
    with (path / "walk.mcap").open("rb") as file:
        schemas = make_reader(file).get_summary().schemas.values()
    definition = {schema.name: schema for schema in schemas}["sensor_msgs/msg/JointState"]
    assert definition.encoding == "ros2msg"
    text = definition.data.decode()
    assert "float64[] position" in text
    assert "MSG: std_msgs/Header" in text


def test_writing_is_deterministic(trace, path, tmp_path):
    bag.write(trace, tmp_path / "walk")
    assert (tmp_path / "walk/walk.mcap").read_bytes() == (path / "walk.mcap").read_bytes()
    assert (tmp_path / "walk/metadata.yaml").read_text() == (path / "metadata.yaml").read_text()


def test_every_command_has_the_stamp_of_its_state(path, trace):
    states, commands = (column(trace, path, name) for name in ("/joint_states", "/joint_velocity_commands"))
    np.testing.assert_array_equal(states.stamps, np.round(trace.time * 1e9))
    np.testing.assert_array_equal(commands.stamps, states.stamps)


def test_times_count_from_the_first_state(trace, tmp_path):
    """Seconds since 1970 in a float are rounded to 0.2 us: stamps are integers, times count from the first state."""
    epoch = 1_795_248_867_614_370_783
    bag.write(dataclasses.replace(trace, epoch=epoch), tmp_path / "walk")
    back = bag.read(tmp_path / "walk")
    assert back.epoch == epoch
    assert not any("is missing" in note for note in back.notes)
    np.testing.assert_allclose(back.time, trace.time, rtol=0.0, atol=1e-12)
    np.testing.assert_allclose([p.time for p in back.phases], [p.time for p in trace.phases], rtol=0.0, atol=1e-12)
    assert column(trace, tmp_path / "walk", "/joint_states").stamps[0] == epoch


def test_states_contain_the_applied_velocities(path, trace):
    velocity = column(trace, path, "/joint_states").velocity
    assert not velocity[0].any()
    np.testing.assert_array_equal(velocity[1:], trace.u[:-1])


def test_base_pose_is_continuous(path, trace):
    """The pelvis does not jump in the odometry frame when the base sole changes."""
    content = storage.load(path, lambda topic, kind: topic == "/base_pose").columns["/base_pose"]
    (poses,) = (messages.pose_of(table.numbers) for table in messages.tables(content))
    step = np.linalg.norm(np.diff(DQ(poses).translation(), axis=0), axis=1)
    assert len(poses) == len(trace.time)
    assert step.max() < 5e-3


def test_diagnostics_have_their_rate_and_all_distances(path, trace):
    content = storage.load(path, lambda topic, kind: topic == "/diagnostics").columns["/diagnostics"]
    found = [messages.unpack(raw, content.type) for raw in content.raws]
    stamps = np.array([m.header.stamp.sec + 1e-9 * m.header.stamp.nanosec for m in found])
    assert np.diff(stamps).max() <= 1.0 / trace.config.monitor.rate + trace.config.dt
    assert len(found) <= (trace.time[-1] - trace.time[0]) * trace.config.monitor.rate + len(trace.phases) + 1
    values = {pair.key: pair.value for pair in found[0].status[0].values}
    assert float(values["distance/tip_plane"]) > 0.0
    assert found[0].status[0].name == "phase_monitor: walk"


def column(trace, path, topic):
    found = storage.load(path, lambda name, kind: name == topic).columns[topic]
    return messages.joint_states(found, trace.model.joint_names)


def test_bags_are_not_overwritten_by_default(trace, path, tmp_path):
    with pytest.raises(BagError, match="exists already"):
        bag.write(trace, path)
    (tmp_path / "walk").mkdir()
    (tmp_path / "walk/old.mcap").touch()
    bag.write(trace, tmp_path / "walk", diagnostics=False, overwrite=True)
    assert not (tmp_path / "walk/old.mcap").exists()
    assert [p.name for p in tmp_path.iterdir()] == ["walk"]


def test_an_interrupted_write_leaves_no_file(trace, tmp_path, monkeypatch):
    def stop(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr("dqwalk_ros.report.bag.storage.connect", stop)
    with pytest.raises(KeyboardInterrupt):
        bag.write(trace, tmp_path / "walk")
    assert list(tmp_path.iterdir()) == []


def test_a_failed_write_is_a_bag_error(trace, tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(BagError, match="cannot write"):
        bag.write(trace, tmp_path / "file" / "walk")


# ---------------------------------------------------------------------- bags of other programs


def test_a_namespace_is_found(trace, path, tmp_path):
    moved = rewrite(path, tmp_path / "b", rename=lambda t: t if t == "/diagnostics" else "/lab/poppy_1" + t)
    assert_same(trace, bag.read(moved))
    assert_same(trace, bag.read(moved, namespace="lab/poppy_1"))
    with pytest.raises(BagError, match="joint_states"):
        bag.read(moved, namespace="poppy_2")


def test_names_of_topics_need_no_slash(trace, path, tmp_path):
    """MCAP files of other writers, such as converters, are not restricted to the names of ROS."""
    assert_same(trace, bag.read(rewrite(path, tmp_path / "b", rename=lambda topic: topic.lstrip("/"))))


def test_two_robots_need_a_namespace(path, tmp_path):
    store = storage.typestore()
    two = tmp_path / "two"
    with Reader(path) as reader, Writer(two, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        out = {
            (robot, c.topic): writer.add_connection(f"/{robot}{c.topic}", c.msgtype, typestore=store)
            for robot in "ab"
            for c in reader.connections
        }
        for c, time, raw in reader.messages():
            for robot in "ab":
                writer.write(out[robot, c.topic], time, raw)
    with pytest.raises(BagError, match=r"2 robots.*/a, /b"):
        bag.read(two)
    assert bag.read(two, namespace="b").finished


def test_joints_are_matched_by_name(trace, path, tmp_path):
    """More joints than in the model, in an order that changes during the recording."""
    rng = np.random.default_rng(0)

    def edit(topic, time, m):
        if topic in ("/joint_states", "/phase_start"):
            order = rng.permutation(len(m.name) + 1)
            m.name = [[*m.name, "head_y"][i] for i in order]
            m.position = np.append(m.position, 9.0)[order]
            m.velocity = np.append(m.velocity, 9.0)[order] if len(m.velocity) else m.velocity
        return time, m

    assert_same(trace, bag.read(rewrite(path, tmp_path / "b", edit=edit)))


def test_commands_are_matched_by_stamp(trace, path, tmp_path):
    """Some are recorded late, some are lost: lost commands are NaN, and a note states their number."""

    def edit(topic, time, m):
        if topic == "/joint_velocity_commands":
            if m.header.stamp.nanosec == 480_000_000:
                return None
            time += 40_000_000
        return time, m

    back = bag.read(rewrite(path, tmp_path / "b", edit=edit))
    lost = ~np.isfinite(back.u).all(axis=1)
    assert lost.any()
    np.testing.assert_allclose(back.time[lost] % 1.0, 0.48)
    np.testing.assert_array_equal(back.u[~lost], trace.u[~lost])
    np.testing.assert_array_equal(back.q, trace.q)
    assert f"{lost.sum()} of {len(back.time)} states have no command" in back.notes


def test_a_recording_that_starts_late(trace, path, tmp_path):
    """The first states are missing: latched messages determine the phase and the pose in the world."""
    second = trace.phases[1]
    since = round(second.time * 1e9) + 2_000_000_000
    latched = {"/" + name for name, topic in TOPICS.items() if topic.latched}
    kept = {}

    def edit(topic, time, m):
        if topic in latched:
            if time < since and topic not in ("/walk_config", "/robot_description") and time < round(second.time * 1e9):
                return None  # the latched message of an earlier phase is missing
            return max(time, since), m
        kept[topic] = kept.get(topic, 0) + (time >= since)
        return (time, m) if time >= since else None

    back = bag.read(rewrite(path, tmp_path / "b", edit=edit))
    assert [p.name for p in back.phases] == [p.name for p in trace.phases[1:]]
    np.testing.assert_array_equal(back.q, trace.q[-len(back.q) :])
    assert back.phases[0].start == 0
    assert back.phases[0].time == pytest.approx(second.time)
    assert any("is missing" in note for note in back.notes)


def test_states_before_and_after_the_walk_are_left_out(trace, path, tmp_path):
    """A plant publishes states while it waits for the walk, answered by zero velocity, and continues after its end."""

    def edit(topic, time, m):
        if (header := getattr(m, "header", None)) is not None:
            header.stamp.sec += 1
        return time + 1_000_000_000, m

    def standing(stamps, topic="/joint_states", **values):
        numbers = {field: np.tile(value, (len(stamps), 1)) for field, value in values.items()}
        raws = messages.pack_joint_states(stamps, trace.model.joint_names, **numbers)
        return [(topic, int(stamp), raw) for stamp, raw in zip(stamps, raws, strict=True)]

    later = rewrite(path, tmp_path / "later", edit=edit)
    end, step = round(trace.time[-1] * 1e9) + 1_000_000_000, 5_000_000
    early, still = np.arange(0, 1_000_000_000, step), np.zeros(trace.model.n)
    before = standing(early, position=still) + standing(early, "/joint_velocity_commands", velocity=still)
    after = standing(end + step * np.arange(1, 11), position=trace.q[-1])
    with Reader(later) as reader, Writer(tmp_path / "b", version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        store = storage.typestore()
        out = {c.topic: writer.add_connection(c.topic, c.msgtype, typestore=store) for c in reader.connections}
        walk = [(out[c.topic], time, raw) for c, time, raw in reader.messages()]
        rest = [[(out[topic], stamp, raw) for topic, stamp, raw in part] for part in (before, after)]
        for message in (*rest[0], *walk, *rest[1]):
            writer.write(*message)
    back = bag.read(tmp_path / "b")
    np.testing.assert_array_equal(back.q, trace.q)
    np.testing.assert_array_equal(back.u, trace.u)
    assert back.notes == ("200 states before the first phase are left out",)


def test_a_failed_walk_is_noted(path, tmp_path):
    def edit(topic, time, m):
        if topic == "/phase" and m.data == FINISHED:
            m.data = "failed"
        return time, m

    back = bag.read(rewrite(path, tmp_path / "b", edit=edit))
    assert back.finished is False
    assert "the walk failed: a phase could not end by its rule" in back.notes


def test_the_warning_that_has_ended_a_walk_is_noted(path, tmp_path):
    def renamed(topic):
        return "/plant_warning" if topic == "/support_foot" else topic

    def edit(topic, time, m):
        m.data = "l_knee_y is at 61 degC"
        return time, m

    back = bag.read(rewrite(path, tmp_path / "b", rename=renamed, edit=edit, edits="/support_foot"))
    assert "the plant has asked for the end of the walk: l_knee_y is at 61 degC" in back.notes


def test_after_a_reset_the_last_run_is_read(trace, path, tmp_path):
    """One bag with two runs, between which the plant was reset."""
    store = storage.typestore()
    twice = tmp_path / "twice"
    cut = round(trace.time[len(trace.time) // 2] * 1e9)
    with Reader(path) as reader, Writer(twice, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        out = {c.topic: writer.add_connection(c.topic, c.msgtype, typestore=store) for c in reader.connections}
        items = list(reader.messages())
        for c, time, raw in items:
            if time < cut:
                writer.write(out[c.topic], time, raw)
        for c, time, raw in items:
            writer.write(out[c.topic], time + cut + 10**9, raw)  # received later, stamps start at zero again
    back = bag.read(twice)
    assert_same(trace, back)
    assert "time went back once: only the last run is read" in back.notes


def test_the_report_says_where_time_jumped(trace, path, tmp_path):
    """A clock that was set ahead during the walk."""
    store, ahead = storage.typestore(), tmp_path / "ahead"
    cut = round(trace.time[len(trace.time) // 2] * 1e9)
    with Reader(path) as reader, Writer(ahead, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        out = {c.topic: writer.add_connection(c.topic, c.msgtype, typestore=store) for c in reader.connections}
        for c, time, raw in reader.messages():
            if c.topic.endswith("joint_states") and time >= cut:
                msg = store.deserialize_cdr(raw, c.msgtype)
                msg.header.stamp.sec += 3600
                raw = store.serialize_cdr(msg, c.msgtype)
            writer.write(out[c.topic], time, raw)
    (note,) = (note for note in bag.read(ahead).notes if "jumps" in note)
    assert f"{1e-9 * cut - trace.config.dt:.3f} s after the first state, time jumps by 3600." in note


@pytest.mark.parametrize("mode", [CompressionMode.FILE, CompressionMode.MESSAGE])
@pytest.mark.parametrize("kind", [StoragePlugin.MCAP, StoragePlugin.SQLITE3])
def test_compressed_bags(trace, path, tmp_path, mode, kind):
    packed = rewrite(
        path,
        tmp_path / "b",
        storage=kind,
        prepare=lambda writer: writer.set_compression(mode, CompressionFormat.ZSTD),
    )
    assert_same(trace, bag.read(packed))


def test_split_bags(trace, path, tmp_path):
    """Two files in one folder, as `ros2 bag record --max-bag-duration` writes them."""
    half = round(trace.time[len(trace.time) // 2] * 1e9)
    for name, keep in (("b_0", lambda t: t < half), ("b_1", lambda t: t >= half)):
        rewrite(path, tmp_path / name, edit=lambda topic, t, m, keep=keep: (t, m) if keep(t) else None)
    split = tmp_path / "b"
    split.mkdir()
    metas = []
    for name in ("b_0", "b_1"):
        shutil.copy(tmp_path / name / f"{name}.mcap", split)
        metas.append(yaml.safe_load((tmp_path / name / "metadata.yaml").read_text())["rosbag2_bagfile_information"])
    meta = metas[0]
    meta["relative_file_paths"] += metas[1]["relative_file_paths"]
    meta["files"] += metas[1]["files"]
    meta["message_count"] += metas[1]["message_count"]
    (split / "metadata.yaml").write_text(yaml.safe_dump({"rosbag2_bagfile_information": meta}))
    assert_same(trace, bag.read(split))
    (split / "metadata.yaml").unlink()
    assert_same(trace, bag.read(split))


def test_a_single_file_of_a_bag_can_be_read(trace, path):
    assert_same(trace, bag.read(path / "walk.mcap"))


# ---------------------------------------------------------------------- damaged bags


@pytest.mark.parametrize("source", ["path", "plain"])
@pytest.mark.parametrize("part", [0.3, 0.85])
def test_the_complete_part_of_a_truncated_bag_is_read(trace, request, tmp_path, source, part):
    source = request.getfixturevalue(source)
    shutil.copytree(source, tmp_path / "b")
    (tmp_path / "b/metadata.yaml").unlink()
    file = tmp_path / "b/walk.mcap"
    data = file.read_bytes()
    file.write_bytes(data[: int(part * len(data))])
    back = bag.read(tmp_path / "b")
    n = len(back.time)
    assert 0.5 * part * len(trace.time) < n < len(trace.time)
    assert_same(trace, back, upto=min(n, np.count_nonzero(np.isfinite(back.u[:, 0]))))
    assert not back.finished
    assert any("damaged or cut off" in note for note in back.notes)


def test_the_unfinished_last_chunk_is_recovered(plain, tmp_path):
    """Only the last few messages are lost, not the rest of the chunk."""
    data = (plain / "walk.mcap").read_bytes()
    cut = int(0.5 * len(data))
    (tmp_path / "cut.mcap").write_bytes(data[:cut])
    n = len(bag.read(tmp_path / "cut.mcap").time)
    (tmp_path / "cut.mcap").write_bytes(data[: cut - 3000])
    assert 0 < n - len(bag.read(tmp_path / "cut.mcap").time) < 40


def test_the_error_of_a_truncated_sqlite_bag_names_a_remedy(path, tmp_path):
    rewrite(path, tmp_path / "b", storage=StoragePlugin.SQLITE3)
    file = tmp_path / "b/b.db3"
    data = file.read_bytes()
    file.write_bytes(data[: int(0.9 * len(data)) // 4096 * 4096])
    with pytest.raises(BagError, match=r"malformed; the \.recover command of sqlite3"):
        bag.read(tmp_path / "b")


@pytest.mark.parametrize("source", ["path", "plain"])
def test_a_bag_is_read_up_to_a_damaged_chunk(trace, request, tmp_path, source):
    shutil.copytree(request.getfixturevalue(source), tmp_path / "b")
    file = tmp_path / "b/walk.mcap"
    data = bytearray(file.read_bytes())
    at = int(0.4 * len(data))
    data[at : at + 20_000] = b"\xff" * 20_000
    file.write_bytes(data)
    back = bag.read(tmp_path / "b")
    assert 0 < len(back.time) < len(trace.time)
    assert back.notes


# ---------------------------------------------------------------------- unusable bags


@pytest.mark.parametrize("topic", ["joint_states", "joint_velocity_commands", "phase", "phase_start", "walk_config"])
def test_a_missing_topic_is_named(path, tmp_path, topic):
    bare = rewrite(path, tmp_path / "b", rename=lambda t: None if t == "/" + topic else t)
    with pytest.raises(BagError, match=rf"no messages on {topic};"):
        bag.read(bare)


def test_the_error_of_another_bag_lists_its_topics(path, tmp_path):
    other = rewrite(path, tmp_path / "b", rename=lambda t: "/chatter" if t == "/phase" else None)
    with pytest.raises(BagError, match=r"no messages on joint_states, .*its topics are /chatter"):
        bag.read(other)


def test_a_whole_body_walk_is_named():
    with pytest.raises(BagError, match="a whole-body walk, which only `dqwalk report` reads"):
        bag.read(Path(__file__).parents[1] / "data/recorded/whole_body")


def test_a_topic_of_another_type_is_not_called_missing(path, tmp_path):
    names = {"/joint_velocity_commands": None, "/support_foot": "/joint_velocity_commands"}
    other = rewrite(path, tmp_path / "b", rename=lambda topic: names.get(topic, topic))
    with pytest.raises(BagError, match=r"messages of another type on joint_velocity_commands \(std_msgs/msg/String\)"):
        bag.read(other)


def test_joints_of_another_robot_are_an_error(path, tmp_path):
    def edit(topic, time, m):
        if topic in ("/joint_states", "/joint_velocity_commands"):
            m.name = ["shoulder" if name == "l_knee_y" else name for name in m.name]
        return time, m

    with pytest.raises(BagError, match=r"another robot: joint_states lack l_knee_y .*shoulder"):
        bag.read(rewrite(path, tmp_path / "b", edit=edit))


@pytest.mark.parametrize(
    ("latched", "own", "other", "expected"),
    [
        ("/robot_description", "l_sole", "left_sole_link", r"another robot.*l_sole"),
        ("/walk_config", "com_radius", "com_diameter", "com_diameter"),
        ("/walk_config", "lock:\n      - ''", "lock:\n      - l_knee_y=bent", "robot.lock has 'l_knee_y=bent'"),
    ],
)
def test_a_description_or_configuration_of_another_robot_is_an_error(path, tmp_path, latched, own, other, expected):
    def edit(topic, time, m):
        if topic == latched:
            m.data = m.data.replace(own, other)
        return time, m

    with pytest.raises(BagError, match=expected):
        bag.read(rewrite(path, tmp_path / "b", edit=edit))


def test_paths_without_a_bag_are_an_error(tmp_path):
    with pytest.raises(BagError, match="no bag at"):
        bag.read(tmp_path / "nowhere")
    with pytest.raises(BagError, match="not a rosbag2"):
        bag.read(tmp_path)
    (tmp_path / "notes.txt").write_text("hello")
    with pytest.raises(BagError, match="is not a bag of ROS 2"):
        bag.read(tmp_path / "notes.txt")
    (tmp_path / "walk.bag").write_text("#ROSBAG V2.0\n")
    with pytest.raises(BagError, match="is a bag of ROS 1"):
        bag.read(tmp_path / "walk.bag")
    (tmp_path / "text.mcap").write_text("hello")
    with pytest.raises(BagError, match="cannot read"):
        bag.read(tmp_path / "text.mcap")


def test_states_without_positions_are_an_error(path, tmp_path):
    def edit(topic, time, m):
        if topic == "/joint_states":
            m.position = m.position[:0]
        return time, m

    with pytest.raises(BagError, match="lack positions of"):
        bag.read(rewrite(path, tmp_path / "b", edit=edit))
