"""Results are complete or not written at all, and nothing that exists is lost."""

import os
from pathlib import Path

import pytest
from full_disk import limited_file_size

from dqwalk_ros.support.errors import OutputError
from dqwalk_ros.support.output import refuse_existing, write_text, written


def test_nothing_that_exists_is_replaced_unless_it_may_be(tmp_path: Path) -> None:
    place = tmp_path / "new" / "walk.txt"
    write_text(place, "mine")
    with pytest.raises(OutputError, match=r"exists already.*--force"):
        write_text(place, "yours")
    assert place.read_text() == "mine"
    write_text(place, "mine")  # nothing is lost
    write_text(place, "yours", overwrite=True)
    assert place.read_text() == "yours"
    assert os.listdir(place.parent) == ["walk.txt"]


@pytest.mark.parametrize("target", ["source.txt", "nowhere.txt"])
def test_links_are_not_followed(tmp_path: Path, target: str) -> None:
    (tmp_path / "source.txt").write_text("mine")
    link = tmp_path / "link.txt"
    link.symlink_to(tmp_path / target)
    with pytest.raises(OutputError, match="exists already"):
        write_text(link, "yours")
    with pytest.raises(OutputError, match="exists already"):
        write_text(link, "mine")
    write_text(link, "yours", overwrite=True)
    assert not link.is_symlink()
    assert (tmp_path / "source.txt").read_text() == "mine"
    assert not (tmp_path / "nowhere.txt").exists()


def test_a_failed_write_leaves_what_was_there(tmp_path: Path) -> None:
    place = tmp_path / "walk.txt"
    place.write_text("mine")

    def fail() -> None:
        with written(place, overwrite=True) as new:
            new.write_text("half of")
            raise OSError("no space")

    with pytest.raises(OSError, match="no space"):
        fail()
    assert place.read_text() == "mine"
    assert os.listdir(tmp_path) == ["walk.txt"]


def test_a_full_disk_is_named_by_the_file(tmp_path: Path) -> None:
    place = tmp_path / "walk.txt"
    with limited_file_size(100), pytest.raises(OSError, match="File too large") as caught:
        write_text(place, "x" * 1000)
    assert caught.value.filename == str(place)
    assert not os.listdir(tmp_path)


def test_a_file_replaces_no_folder_and_no_device(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "folder").mkdir()
    for name in ("pipe", "folder"):
        with pytest.raises(OutputError, match="is not a file, and is not replaced"):
            write_text(tmp_path / name, "yours", overwrite=True)
    assert (tmp_path / "folder").is_dir()
    with pytest.raises(OutputError, match="exists already"):
        refuse_existing([tmp_path / "none", tmp_path / "pipe"])


def test_a_file_has_the_usual_rights(tmp_path: Path) -> None:
    write_text(tmp_path / "ours", "")
    (tmp_path / "usual").touch()
    assert (tmp_path / "ours").stat().st_mode == (tmp_path / "usual").stat().st_mode
