"""A robot is parsed once per machine, and the cache changes nothing but the time."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from dqwalk_ros import parsed
from dqwalk_ros.errors import ModelError

ROOT = Path(__file__).resolve().parent.parent
ROBOTS = [ROOT / "urdf" / "poppy.urdf", ROOT / "urdf" / "hrp2_like.urdf", ROOT / "test" / "data" / "biped12.urdf"]


@pytest.fixture(autouse=True)
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    return tmp_path / "dqwalk_ros" / "robots"


def same(a: parsed.Robot, b: parsed.Robot) -> None:
    np.testing.assert_equal(parsed.dataclasses.asdict(a), parsed.dataclasses.asdict(b))


@pytest.mark.parametrize("path", ROBOTS, ids=lambda path: path.stem)
def test_what_is_kept_is_what_was_parsed(path: Path, cache: Path) -> None:
    data = path.read_bytes()
    first = parsed.parse(data, str(path))
    assert len(list(cache.iterdir())) == 1
    same(parsed.parse(data, str(path)), first)
    assert first.links
    assert {joint.child for joint in first.joints} < {link.name for link in first.links}


def test_the_second_time_yourdfpy_is_not_imported() -> None:
    code = (
        "import sys\nfrom dqwalk_ros import load, load_model\nload_model(load('paper').robot)\n"
        "print('yourdfpy' in sys.modules, 'trimesh' in sys.modules)"
    )
    command = [sys.executable, "-c", code]
    runs = [subprocess.run(command, capture_output=True, text=True, check=True, cwd=ROOT) for _ in range(2)]
    found = [run.stdout.strip() for run in runs]
    assert found == ["True True", "False False"]


@pytest.mark.parametrize("junk", ["", "{", "[]", '{"name": "x"}', '{"name": "x", "links": [{}], "joints": []}', "null"])
def test_a_damaged_cache_is_no_error(cache: Path, junk: str) -> None:
    data = ROBOTS[0].read_bytes()
    first = parsed.parse(data, "poppy")
    (file,) = cache.iterdir()
    file.write_text(junk)
    same(parsed.parse(data, "poppy"), first)
    same(parsed.parse(data, "poppy"), first)  # and it is mended


def test_a_home_that_cannot_be_written_is_no_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    blocked = tmp_path / "file"
    blocked.write_text("not a folder")
    monkeypatch.setenv("XDG_CACHE_HOME", str(blocked))
    assert parsed.parse(ROBOTS[0].read_bytes(), "poppy").name == "poppy_humanoid"


def test_what_is_refused_is_not_kept(cache: Path) -> None:
    with pytest.raises(ModelError, match="not a URDF"):
        parsed.parse(b"<robot name='x'><joint/></robot>", "x")
    assert not cache.exists() or not list(cache.iterdir())


def test_old_robots_go(cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(parsed, "_KEPT", 3)
    text = ROBOTS[2].read_text()
    for k in range(5):
        parsed.parse(text.replace("<robot name=", f"<!-- {k} --><robot name=").encode(), "x")
        newest = max(cache.iterdir(), key=lambda file: file.stat().st_mtime_ns)
        os.utime(newest, ns=(k * 10**9, k * 10**9))
    assert len(list(cache.iterdir())) == 3
