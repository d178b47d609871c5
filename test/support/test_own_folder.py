"""Folders and locks that no other user can have prepared."""

from __future__ import annotations

import os
import pwd
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

import pytest

from dqwalk_ros.support.cache import cache_folder
from dqwalk_ros.support.own_folder import lock, own_folder, temporary


def test_a_folder_is_made_for_its_user_only(tmp_path: Path) -> None:
    made = own_folder(tmp_path / "cache" / "mine")
    assert made.stat().st_mode & 0o777 == 0o700
    (made / "kept").touch()
    assert (own_folder(made) / "kept").exists()


def link(path: Path) -> None:
    path.with_name("target").mkdir()
    path.symlink_to("target")


def of_another_user(path: Path) -> None:
    path.mkdir(mode=0o700)
    os.chown(path, 12345, 12345)


def writable(path: Path) -> None:
    path.mkdir()
    path.chmod(0o777)


PREPARED: dict[str, Callable[[Path], None]] = {"a file": Path.touch, "a link": link, "writable by others": writable}
PREPARED |= {"of another user": of_another_user} if os.getuid() == 0 else {}


@pytest.mark.parametrize("how", PREPARED)
def test_a_folder_that_others_can_have_filled_is_refused(how: str, tmp_path: Path) -> None:
    PREPARED[how](tmp_path / "mine")
    with pytest.raises(PermissionError, match="others can have filled"):
        own_folder(tmp_path / "mine")


@pytest.mark.parametrize("mode", [0o777, 0o1777])
def test_others_may_write_above_only_where_they_cannot_rename(mode: int, tmp_path: Path) -> None:
    above = tmp_path / "shared"
    above.mkdir()
    above.chmod(mode)
    if mode & 0o1000:
        assert own_folder(above / "mine").is_dir()
    else:
        with pytest.raises(PermissionError, match="others can replace 'mine'"):
            own_folder(above / "mine")


def test_a_lock_is_held_once_and_released(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    held = lock("one")
    assert held is not None
    assert lock("one") is None
    held.close()
    again = lock("one")
    assert again is not None
    again.close()


def test_no_lock_is_opened_through_a_prepared_link(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    victim = tmp_path / "victim"
    victim.mkdir()
    (victim / "one.lock").write_text("precious")
    temporary().symlink_to(victim)
    with pytest.raises(PermissionError):
        lock("one")
    assert (victim / "one.lock").read_text() == "precious"


# ---------------------------------------------------------------------- the cache of compiled functions


@pytest.fixture
def homeless(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """As in a container, without a home and without a passwd entry; the temporary folder is returned."""

    def no_entry(user: int) -> None:
        raise KeyError(user)

    for name in ("HOME", "XDG_CACHE_HOME"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(pwd, "getpwuid", no_entry)
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_without_a_home_the_cache_is_in_the_temporary_folder(homeless: Path) -> None:
    assert cache_folder() == homeless / f"dqwalk_ros-{os.getuid()}"
    assert [path.name for path in homeless.iterdir()] == [f"dqwalk_ros-{os.getuid()}"]


@pytest.mark.parametrize("how", PREPARED)
def test_a_prepared_cache_is_not_used(how: str, homeless: Path) -> None:
    PREPARED[how](temporary())
    with pytest.raises(PermissionError, match="others can have filled"):
        cache_folder()


def test_without_a_cache_each_process_compiles(homeless: Path) -> None:
    PREPARED["a link"](temporary())
    code = "import dqwalk_ros.support.compiled as c; print(c.numba.config.CACHE_DIR, type(c.jit(c.jit)._cache))"
    environment = {"PATH": os.environ["PATH"], "TMPDIR": str(homeless), "XDG_CACHE_HOME": "/dev/null"}
    shown = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True)
    assert shown.stdout.split() == ["<class", "'numba.core.caching.NullCache'>"]


def test_without_a_home_ros_logs_into_the_temporary_folder(homeless: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from dqwalk_ros.nodes.wheels import find_log_folder

    monkeypatch.setenv("ROS_LOG_DIR", "given")
    find_log_folder()
    assert os.environ["ROS_LOG_DIR"] == "given"
    monkeypatch.delenv("ROS_LOG_DIR")
    find_log_folder()
    assert os.environ["ROS_LOG_DIR"] == str(homeless / f"dqwalk_ros-{os.getuid()}" / "log")
