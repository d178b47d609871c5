"""The cache on disk: what is remembered, for how long, and what of it is trusted."""

from __future__ import annotations

import os
import pickle
from pathlib import Path

import pytest

from dqwalk_ros.support import cache
from dqwalk_ros.support.cache import cache_folder, remembered


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    return tmp_path / "dqwalk_ros" / "numbers"


def test_a_result_is_made_once_per_key(folder: Path) -> None:
    assert [remembered("numbers", key, lambda n=n: n) for n, key in enumerate([b"a", b"b", b"a"])] == [0, 1, 0]
    assert cache_folder() == folder.parent


@pytest.mark.parametrize("content", [b"", pickle.dumps(list(range(9)))[:-3], b"no pickle", b"cno_module\nno_name\n."])
def test_a_damaged_result_is_made_again(folder: Path, content: bytes) -> None:
    remembered("numbers", b"a", lambda: 1)
    (file,) = folder.iterdir()
    file.write_bytes(content)
    assert remembered("numbers", b"a", lambda: 2) == 2
    assert remembered("numbers", b"a", lambda: 3) == 2


def test_a_result_that_is_used_is_kept(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cache, "_MOST", 2)
    remembered("numbers", b"used", lambda: 0)
    for n in range(4):
        for file in folder.iterdir():  # as if a second later
            os.utime(file, ns=(file.stat().st_atime_ns, file.stat().st_mtime_ns - 10**9))
        assert remembered("numbers", b"used", lambda: -1) == 0
        remembered("numbers", bytes([n]), lambda n=n: n)


def test_the_latest_results_are_kept(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cache, "_MOST", 3)
    for n in range(5):
        remembered("numbers", bytes([n]), lambda n=n: n)
        for file in folder.iterdir():  # as if made a second earlier
            os.utime(file, ns=(file.stat().st_atime_ns, file.stat().st_mtime_ns - 10**9))
    assert len([*folder.iterdir()]) == 3
    assert [remembered("numbers", bytes([n]), lambda: -1) for n in (2, 3, 4)] == [2, 3, 4]


def test_what_others_can_have_written_is_not_read(folder: Path) -> None:
    remembered("numbers", b"a", lambda: 1)
    folder.chmod(0o777)
    assert remembered("numbers", b"a", lambda: 2) == 2


def test_an_error_is_not_remembered(folder: Path) -> None:
    with pytest.raises(ZeroDivisionError):
        remembered("numbers", b"a", lambda: 1 // 0)
    assert remembered("numbers", b"a", lambda: 2) == 2
