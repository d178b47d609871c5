"""Hostile and broken robot descriptions: each refused, with the element and its line."""

from __future__ import annotations

import dataclasses
import time
from pathlib import Path

import pytest

from dqwalk_ros.config import load
from dqwalk_ros.description import MAX_LINKS, checked
from dqwalk_ros.errors import ModelError
from dqwalk_ros.model import load_model

ROOT = Path(__file__).resolve().parent.parent
POPPY = (ROOT / "urdf" / "poppy.urdf").read_text(encoding="utf-8")
MASS = '<mass value="1"/>'
ROUND = '<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/>'


def link(name: str = "b", inertial: str = "", more: str = "") -> str:
    return f'<link name="{name}">{f"<inertial>{inertial}</inertial>" if inertial else ""}{more}</link>'


def joint(name: str = "j", parent: str = "a", child: str = "b", kind: str = "revolute", more: str | None = None) -> str:
    inside = '<axis xyz="0 0 1"/><limit lower="-1" upper="1" velocity="7" effort="3"/>' if more is None else more
    return f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>{inside}</joint>'


def robot(*parts: str) -> str:
    return '<robot name="r">\n' + "\n".join(parts) + "\n</robot>"


A, B, J = link("a"), link("b", MASS + ROUND), joint()
DEEP = "<a>" * 100_000

BAD = {
    "empty": ("", "not XML"),
    "not xml": ("hello", "not XML"),
    "cut off": (POPPY[:5000], "not XML"),
    "another root": ("<svg/>", "line 1: not a URDF: <svg>"),
    "no name": ("<robot><link name='a'/></robot>", "line 1: <robot> has no name"),
    "no links": (robot(), "no links"),
    "doctype": (f'<!DOCTYPE robot SYSTEM "file:///etc/passwd">{robot(A)}', "line 1: <!DOCTYPE is not allowed"),
    "bomb": ('<!DOCTYPE r [<!ENTITY a "aaaa"><!ENTITY b "&a;&a;">]>' + robot(A), "DOCTYPE"),
    "undefined entity": (robot("<link name='&xxe;'/>"), "not XML"),
    "too deep": (robot(A, DEEP), "not XML"),
    "too large": (robot(A, " " * (1 << 20)), "bytes, at most"),
    "too many links": (robot(*(link(f"l{i}") for i in range(MAX_LINKS + 1))), rf"line {MAX_LINKS + 2}: .*one too many"),
    "nameless link": (robot("<link/>"), "line 2: <link> has no name"),
    "doubled link": (robot(A, A), "line 3: <link> 'a' has the name of the one in line 2"),
    "doubled joint": (robot(A, B, link("c"), J, joint(child="c")), "line 6: <joint> 'j' has the name"),
    "two roots": (robot(A, B), "one root link, this has 2: a, b"),
    "a loop": (robot(A, B, J, joint("k", "b", "a")), "one root link, this has 0"),
    "a loop beside": (
        robot(A, B, link("c"), joint("j", "b", "c"), joint("k", "c", "b")),
        "line 3: <link> 'b' is part of a loop",
    ),
    "its own parent": (robot(A, B, joint("j", "b", "b")), "line 3: <link> 'b' is part of a loop"),
    "two parents": (robot(A, B, J, joint("k")), "line 5: <joint> 'k' is the second joint"),
    "no such parent": (robot(A, B, joint(parent="x")), "names the parent 'x'"),
    "no such child": (robot(A, joint()), "names the child 'b'"),
    "no parent": (robot(A, '<joint name="j" type="fixed"><child link="a"/></joint>'), 'one <parent link="..."/>'),
    "joint type": (robot(A, B, joint(kind="magic")), "line 4: <joint> 'j' has the type 'magic'"),
    "no limit": (robot(A, B, joint(more="")), "line 4: <joint> 'j' has no <limit>"),
    "nan limit": (robot(A, B, joint(more='<limit lower="nan" upper="1"/>')), "<limit> has lower = 'nan'"),
    "inf limit": (robot(A, B, joint(more='<limit lower="-inf" upper="1"/>')), "has lower = '-inf'"),
    "1e999": (robot(A, B, joint(more='<limit lower="0" upper="1e999"/>')), "has upper = '1e999'"),
    "words": (robot(A, B, joint(more='<limit lower="0" upper="1_0"/>')), "has upper = '1_0'"),
    "turned limits": (robot(A, B, joint(more='<limit lower="1" upper="-1"/>')), "lower 1 and upper -1"),
    "equal limits": (robot(A, B, joint(more='<limit lower="1" upper="1"/>')), "lower must be less"),
    "negative velocity": (robot(A, B, joint(more='<limit lower="0" upper="1" velocity="-1"/>')), "negative velocity"),
    "two limits": (robot(A, B, joint(more='<limit upper="1"/><limit upper="2"/>')), "has 2 <limit>"),
    "long axis": (
        robot(A, B, joint(more='<axis xyz="0 0 2"/><limit lower="0" upper="1"/>')),
        "line 4: <axis> of joint 'j' has the length 2",
    ),
    "no axis": (robot(A, B, joint(more='<axis xyz="0 0 0"/><limit lower="0" upper="1"/>')), "has the length 0"),
    "flat axis": (
        robot(A, B, joint(more='<axis xyz="0 1"/><limit lower="0" upper="1"/>')),
        "must have 3 numbers in xyz",
    ),
    "nan origin": (
        robot(A, B, joint(more='<origin xyz="0 nan 0"/><limit lower="0" upper="1"/>')),
        "<origin> has xyz = 'nan'",
    ),
    "far origin": (robot(A, B, joint(more='<origin xyz="0 1e9 0"/><limit lower="0" upper="1"/>')), "'1e9'"),
    "nan mimic": (
        robot(A, B, joint(more='<limit upper="1"/><mimic joint="j" multiplier="nan"/>')),
        "<mimic> has multiplier",
    ),
    "no mass": (robot(link("a", '<mass value="0"/>')), "line 2: <mass> of link 'a' must be above zero"),
    "negative mass": (robot(link("a", '<mass value="-1"/>')), "above zero, got -1"),
    "nan mass": (robot(link("a", '<mass value="nan"/>')), "<mass> has value = 'nan'"),
    "two masses": (robot(link("a", MASS + MASS)), "has 2 <mass>"),
    "indefinite": (
        robot(link("a", MASS + ROUND.replace('ixy="0"', 'ixy="2"'))),
        "line 2: <inertia> of link 'a' is not positive definite",
    ),
    "no body": (robot(link("a", MASS + ROUND.replace('izz="1"', 'izz="3"'))), "is of no body"),
    "half an inertia": (robot(link("a", MASS + '<inertia ixx="1"/>')), "has ixy = ''"),
    "box": (robot(link("a", more='<collision><geometry><box size="1 0 1"/></geometry></collision>')), "above zero"),
    "sphere": (robot(link("a", more='<visual><geometry><sphere radius="-1"/></geometry></visual>')), "above zero"),
    "two shapes": (
        robot(link("a", more='<visual><geometry><sphere radius="1"/><sphere radius="1"/></geometry></visual>')),
        "has 2 shapes",
    ),
}


@pytest.mark.parametrize("name", BAD)
def test_it_is_refused_with_the_place(name: str, tmp_path: Path) -> None:
    text, expected = BAD[name]
    path = tmp_path / "bad.urdf"
    path.write_text(text, encoding="utf-8")
    began = time.process_time()
    with pytest.raises(ModelError, match=expected):
        load_model(dataclasses.replace(load("paper").robot, urdf=str(path)))
    assert time.process_time() - began < 2.0


@pytest.mark.parametrize(
    "data",
    [
        robot(A).encode("utf-16"),
        b'<?xml version="1.0" encoding="utf-7"?>+ADwAIQ-DOCTYPE r+AD4-' + robot(A).encode(),
        b"\xff\xfe\x00",
        b"\x00" * 100,
        b'<?xml version="1.0" encoding="ebcdic-cp-us"?><robot/>',
    ],
)
def test_an_encoding_hides_nothing(data: bytes) -> None:
    with pytest.raises(ModelError):
        checked(data, "x.urdf")


def test_a_folder_and_a_device_are_no_robots(tmp_path: Path) -> None:
    with pytest.raises(ModelError):
        load_model(dataclasses.replace(load("paper").robot, urdf=str(tmp_path)))
    with pytest.raises(ModelError):
        load_model(dataclasses.replace(load("paper").robot, urdf="/dev/zero"))


def test_no_mesh_is_opened(tmp_path: Path) -> None:
    trap = tmp_path / "trap.stl"
    mesh = f'<visual><geometry><mesh filename="{trap}"/></geometry></visual>'
    text = POPPY.replace('<link name="pelvis">', f'<link name="pelvis">{mesh}', 1)
    assert text != POPPY
    import os

    os.mkfifo(trap)  # whoever opens it waits forever
    path = tmp_path / "poppy.urdf"
    path.write_text(text, encoding="utf-8")
    assert load_model(dataclasses.replace(load("paper").robot, urdf=str(path))).n == 10


@pytest.mark.parametrize(
    "path", [*(ROOT / "urdf").glob("*.urdf"), *(ROOT / "test" / "data").glob("*.urdf")], ids=lambda p: p.name
)
def test_our_own_pass(path: Path) -> None:
    checked(path.read_bytes(), path.name)
