"""What commands write: nothing that exists is lost, and results are written before they are printed."""

from __future__ import annotations

import errno
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from recorded import SHORT, short_walk

from dqwalk_ros import cli
from dqwalk_ros.report import bag, figures
from dqwalk_ros.report.figures.style import new_figure
from dqwalk_ros.support.errors import OutputError

ROBOT = Path(__file__).parents[1] / "data" / "small_humanoid.urdf"
FAST = [word for key, value in SHORT.items() for word in ("--set", f"{key}={value}")]
ADOPT = ["adopt", "robot.urdf", "--yes", "--no-walk", "--quiet"]


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the bag of a short walk."""
    path = tmp_path_factory.mktemp("recorded") / "bag"
    bag.write(short_walk(), path)
    return path


def test_adopt_never_changes_the_robot_it_reads(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    shutil.copy(ROBOT, "robot.urdf")
    (tmp_path / "sub").mkdir()
    for given in ([], ["--force"]):
        for out in (".", str(tmp_path), "sub/.."):
            assert cli.main([*ADOPT, "--out", out, *given]) == 2
            assert "is the robot description itself" in capsys.readouterr().err
    assert sorted(file.name for file in tmp_path.iterdir()) == ["robot.urdf", "sub"]
    assert (tmp_path / "robot.urdf").read_bytes() == ROBOT.read_bytes()


@pytest.mark.parametrize("name", ["robot.urdf", "paper.yaml", "robot.png", "adopt.json", "whole_body.yaml"])
def test_adopt_replaces_no_file_of_the_user(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    shutil.copy(ROBOT, "robot.urdf")
    (tmp_path / "mine").write_text("mine")
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / name).symlink_to("../mine")
    assert cli.main([*ADOPT, "--out", "out"]) == 2
    assert "exists already" in capsys.readouterr().err
    assert len(list((tmp_path / "out").iterdir())) == 1
    assert (tmp_path / "mine").read_text() == "mine"


def test_adopt_with_force_replaces_links_not_what_they_lead_to(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    shutil.copy(ROBOT, "robot.urdf")
    (tmp_path / "out").mkdir()
    for name in ("robot.urdf", "paper.yaml"):
        (tmp_path / f"mine_{name}").write_text("mine")
        (tmp_path / "out" / name).symlink_to(tmp_path / f"mine_{name}")
    assert cli.main([*ADOPT, "--out", "out", "--force"]) == 0
    for name in ("robot.urdf", "paper.yaml"):
        assert (tmp_path / f"mine_{name}").read_text() == "mine"
        assert "mine" not in (tmp_path / "out" / name).read_text()


COMMANDS = {
    "simulate": (["simulate", *FAST, "--out", "."], "report.json"),
    "walk": (["walk", *FAST, "--out", "."], "log"),
    "exercise": (["exercise", "--ros", "--out", "."], "log"),
    "report": (["report", "BAG", "--out", ".", "--no-figures"], "report.json"),
    "a figure of report": (["report", "BAG", "--out", "."], "top_view.png"),
    "the page of report": (["report", "BAG", "--out", ".", "--html", "--no-figures"], "report.html"),
    "the series of report": (["report", "BAG", "--out", ".", "--csv", "--no-figures"], "series.csv"),
    "movie": (["movie", "BAG", "--out", "walk.gif"], "walk.gif"),
    "identify": (["identify", "BAG", "--out", "mine.yaml"], "mine.yaml"),
    "robustness": (["robustness", "--steps", "1", "--out", "."], "robustness.csv"),
    "pushes": (["pushes", "--out", "."], "pushes.png"),
    "study": (["study", str(Path("study.yaml")), "--out", "."], "study.png"),
    "the walks of a study": (["study", "study.yaml", "--out", "."], "walks.parquet"),
    "reach": (["reach", "--out", "."], "bag_2"),
}


@pytest.mark.parametrize("name", COMMANDS)
@pytest.mark.parametrize("linked", [False, pytest.param(True, marks=pytest.mark.long)])
@pytest.mark.usefixtures("few_figures")
def test_no_command_replaces_a_file_of_the_user(
    name: str,
    linked: bool,
    recorded: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    command, file = COMMANDS[name]
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mine").write_text("mine")
    if linked:
        Path(file).symlink_to("mine")
    else:
        Path(file).write_text("mine")
    Path("study.yaml").write_text("config: paper\nset: {gait.cycles: 1}\nvary: {gait.step_length: [0.02]}\n")
    assert cli.main([str(recorded) if word == "BAG" else word for word in command]) == 1
    assert f"{file}' exists already" in capsys.readouterr().err
    assert Path(file).read_text() == "mine"
    assert Path(file).is_symlink() == linked
    assert (tmp_path / "mine").read_text() == "mine"


@pytest.fixture
def few_figures(monkeypatch: pytest.MonkeyPatch) -> None:
    """One figure that is quickly drawn."""
    monkeypatch.setattr(figures, "FIGURES", {"top_view": (lambda series: new_figure(2.0, 1.0), "")})


@pytest.mark.usefixtures("few_figures")
def test_the_same_report_can_be_made_again(recorded: Path, tmp_path: Path) -> None:
    command = ["report", str(recorded), "--out", str(tmp_path), "--quiet", "--format", "png,svg"]
    assert cli.main(command) == 0
    made = {file: file.stat().st_mtime_ns for file in tmp_path.iterdir()}
    assert cli.main(command) == 0
    assert {file: file.stat().st_mtime_ns for file in tmp_path.iterdir()} == made
    (tmp_path / "top_view.png").write_text("mine")
    assert cli.main([*command, "--force"]) == 0
    assert (tmp_path / "top_view.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize("force", [[], ["--force"]])
def test_a_study_writes_through_no_link(tmp_path: Path, force: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "mine").write_text("mine")
    (tmp_path / "limits.jsonl").symlink_to("mine")
    assert cli.main(["pushes", "--out", str(tmp_path), *force]) == 1
    assert "it is a link" in capsys.readouterr().err
    assert (tmp_path / "mine").read_text() == "mine"


def test_a_file_is_no_folder_of_a_study(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "mine").write_text("mine")
    assert cli.main(["pushes", "--out", str(tmp_path / "mine")]) == 1
    assert capsys.readouterr().err == f"dqwalk: '{tmp_path / 'mine'}' is a file, not a folder\n"


def test_a_link_called_bag_is_replaced_not_what_it_leads_to(recorded: Path, tmp_path: Path) -> None:
    from dqwalk_ros.cli.results import prepare

    (tmp_path / "bag").symlink_to(recorded)
    with pytest.raises(OutputError, match="exists already"):
        prepare(tmp_path, force=False)
    prepare(tmp_path, force=True)
    assert not (tmp_path / "bag").is_symlink()
    assert (recorded / "metadata.yaml").exists()


@pytest.mark.parametrize("encoding", ["ascii", pytest.param("latin-1", marks=pytest.mark.long)])
def test_a_report_is_written_on_any_terminal(encoding: str, recorded: Path, tmp_path: Path) -> None:
    out = tmp_path / "größe-尺寸"
    script = "import sys; from dqwalk_ros.cli import main; sys.exit(main())"
    done = subprocess.run(
        [sys.executable, "-c", script, "report", str(recorded), "--out", str(out), "--no-figures"],
        env=os.environ | {"PYTHONIOENCODING": encoding, "MPLBACKEND": "nonsense"},
        capture_output=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert b"OK: every constraint was kept" in done.stdout
    assert (out / "report.json").exists()


@pytest.mark.usefixtures("few_figures")
def test_results_are_written_before_they_are_printed(
    recorded: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    class Closed(Exception):
        pass

    def fail(*_: object, **__: object) -> None:
        raise Closed

    monkeypatch.setattr("builtins.print", fail)
    with pytest.raises(Closed):
        cli.main(["report", str(recorded), "--out", str(tmp_path), "--csv"])
    assert {"report.json", "series.csv", "top_view.png"} <= {file.name for file in tmp_path.iterdir()}


@pytest.mark.parametrize("command", [["simulate"], ["adopt", "robot.urdf"], ["movie", "bag"], ["pushes"]])
def test_a_folder_that_cannot_be_written_to_is_found_before_anything_is_computed(
    command: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Another user's, or one of a file system that is mounted read-only."""
    rights = os.access
    monkeypatch.setattr(os, "access", lambda path, mode: not mode & os.W_OK and rights(path, mode))
    assert cli.main([*command, "--out", str(tmp_path / "new/one")]) == 2
    assert f"'{tmp_path}' is read-only, or not writable for this user" in capsys.readouterr().err


@pytest.mark.usefixtures("few_figures")
@pytest.mark.parametrize("lost", ["dqwalk_ros.report.bag.write", "dqwalk_ros.cli.results.write_text"])
def test_a_walk_that_cannot_be_written_is_reported_all_the_same(
    lost: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def full(*_: object, **__: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device", "bag")

    monkeypatch.setattr(lost, full)
    quick = {"task.eta": 2.0, "ssp.threshold": 0.02, "dsp.stall_rate": 0.005}
    command = ["simulate", "--out", str(tmp_path), *(f"--set={key}={value}" for key, value in quick.items())]
    assert cli.main(command) == 1
    shown = capsys.readouterr()
    assert "steps " in shown.out
    assert shown.err.splitlines()[-1] == "dqwalk: No space left on device: 'bag'"


def test_a_bag_may_be_the_present_folder(recorded: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    shutil.copytree(recorded, tmp_path / "bag")
    monkeypatch.chdir(tmp_path / "bag")
    assert cli.main(["report", ".", "--no-figures", "--quiet"]) == 0
    assert (tmp_path / "bag_report/report.json").exists()


def test_the_root_folder_is_no_bag(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["report", "/"]) == 1
    assert "'/' is not a rosbag2" in capsys.readouterr().err
