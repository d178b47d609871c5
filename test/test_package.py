"""The installed package: its metadata agree, and the result of colcon runs (``make colcon``)."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import venv
from pathlib import Path
from xml.etree import ElementTree

import pytest

import dqwalk_ros
from dqwalk_ros.nodes.command_line import NODES

ROOT = Path(__file__).resolve().parent.parent


def test_the_version_is_one() -> None:
    version = dqwalk_ros.__version__
    assert ElementTree.parse(ROOT / "package.xml").findtext("version") == version
    assert f'version="{version}"' in (ROOT / "setup.py").read_text(encoding="utf-8")
    assert f"\nversion: {version}\n" in (ROOT / "CITATION.cff").read_text(encoding="utf-8")


def test_every_node_is_installed() -> None:
    """setup.py cannot import the package that it installs."""
    (listed,) = re.findall(r"^NODES = \((.*?)\)", (ROOT / "setup.py").read_text(), re.M | re.S)
    assert sorted(re.findall(r'"(\w+)"', listed)) == sorted(NODES)
    assert sorted(file.name for file in (ROOT / "scripts").iterdir()) == sorted(NODES)


def test_package_xml_names_what_the_nodes_import() -> None:
    declared = {e.text for e in ElementTree.parse(ROOT / "package.xml").iter() if e.tag.endswith("depend")}
    imported = set()
    for file in (ROOT / "dqwalk_ros" / "nodes").glob("*.py"):
        imported |= set(
            re.findall(r"^\s*(?:from|import) (\w+(?:_msgs|_srvs|_interfaces)|rclpy)\b", file.read_text(), re.M)
        )
    assert imported <= declared, imported - declared


@pytest.mark.colcon
@pytest.mark.timeout(900)
def test_colcon_builds_and_its_executables_run(tmp_path: Path) -> None:
    """In a virtual environment of its own that sees this one's packages."""
    colcon = shutil.which("colcon")
    prefixes = os.environ.get("AMENT_PREFIX_PATH", sys.prefix)
    if colcon is None:
        venv.create(tmp_path / "venv", with_pip=True)
        python = tmp_path / "venv" / "bin" / "python"
        subprocess.run(
            [python, "-m", "pip", "install", "--quiet", "colcon-common-extensions", "setuptools<80"], check=True
        )
        # colcon runs setup.py with its own Python, the nodes need the packages of this one
        site = next((tmp_path / "venv" / "lib").glob("python*")) / "site-packages"
        (site / "outer.pth").write_text("\n".join(p for p in sys.path if p.endswith("-packages")) + "\n")
        colcon = str(tmp_path / "venv" / "bin" / "colcon")
    environment = {**os.environ, "AMENT_PREFIX_PATH": prefixes}
    base = ["--build-base", str(tmp_path / "build"), "--install-base", str(tmp_path / "install")]
    built = subprocess.run(
        [colcon, "--log-base", str(tmp_path / "log"), "build", "--base-paths", str(ROOT), *base],
        cwd=tmp_path,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert built.returncode == 0, built.stdout + built.stderr
    prefix = tmp_path / "install" / "dqwalk_ros"
    share = prefix / "share"
    assert (share / "ament_index" / "resource_index" / "packages" / "dqwalk_ros").is_file()
    for file in ("package.xml", "config/paper.yaml", "urdf/poppy.urdf", "launch/walk.launch.py"):
        assert (share / "dqwalk_ros" / file).is_file(), file
    for name in NODES:
        command = f". '{tmp_path}/install/setup.sh' && exec '{prefix}/lib/dqwalk_ros/{name}' --help"
        shown = subprocess.run(
            ["sh", "-c", command],
            cwd=tmp_path,
            env={**environment, "PATH": f"{Path(sys.executable).parent}:{os.environ['PATH']}"},
            capture_output=True,
            text=True,
            check=False,
        )
        assert shown.returncode == 0, shown.stderr
        assert "Example:" in shown.stdout


def test_the_aggregator_knows_every_status() -> None:
    import yaml

    tree = yaml.safe_load((ROOT / "config" / "diagnostics_aggregator.yaml").read_text())["/**"]["ros__parameters"]
    known = {name for one in tree.values() if isinstance(one, dict) for name in one["contains"]}
    assert {name.partition(":")[0] for name in known} <= set(NODES)
    said = set()
    for file in (ROOT / "dqwalk_ros" / "nodes").glob("*.py"):
        said |= set(re.findall(r"\.diagnose\(\s*\"(\w+)\"", file.read_text(encoding="utf-8")))
    assert {name.partition(": ")[2] for name in known} >= said


# ---------------------------------------------------------------------- rosdep

KNOWN = "2026-08-22"
KEYS = """
builtin_interfaces diagnostic_msgs dynamixel_sdk geometry_msgs launch launch_ros nav_msgs rcl_interfaces rclpy
rosgraph_msgs sensor_msgs std_msgs std_srvs tf2_msgs trajectory_msgs visualization_msgs xacro python3-click
python3-collada python3-hypothesis python3-joblib python3-matplotlib python3-numba python3-numpy
python3-psutil python3-pytest python3-pytest-timeout python3-pytest-xdist python3-rich python3-rosbags-pip
python3-scipy python3-serial python3-tqdm python3-yaml python3-yourdfpy-pip
"""
"""Keys that exist, as rosdistro had them on that day: packages of Jazzy, and rosdep/python.yaml."""
ROSDISTRO = "https://raw.githubusercontent.com/ros/rosdistro/master/"


def keys() -> set[str]:
    return {e.text or "" for e in ElementTree.parse(ROOT / "package.xml").iter() if e.tag.endswith("depend")}


def test_every_dependency_has_a_rosdep_key() -> None:
    """With one that does not exist `rosdep install` installs nothing at all."""
    known = set(KEYS.split())
    assert keys() <= known, f"look {keys() - known} up in rosdistro, then add it to the table"


@pytest.mark.long
def test_rosdistro_has_the_keys_still() -> None:
    import urllib.error
    import urllib.request

    known: set[str] = set()
    for name in ("jazzy/distribution.yaml", "rosdep/python.yaml"):
        try:
            text = urllib.request.urlopen(ROSDISTRO + name, timeout=20).read().decode()
        except (urllib.error.URLError, TimeoutError) as error:
            pytest.skip(f"rosdistro cannot be reached ({error}); the table of {KNOWN} is checked")
        known |= set(re.findall(r"^ *(?:- )?([\w-]+):? *$", text, re.M))
    assert keys() <= known, keys() - known


@pytest.mark.long
@pytest.mark.timeout(900)
def test_the_tests_run_with_declared_dependencies_only() -> None:
    """As `colcon test` does where nothing else is installed: 12 files could not be collected, and none ran."""
    run = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "-p", "declared"]
    where = {"cwd": ROOT, "env": {**os.environ, "PYTHONPATH": f"{ROOT}:{ROOT / 'test'}"}, "text": True}
    collected = subprocess.run([*run, "--co", "test"], capture_output=True, check=False, **where)
    assert collected.returncode == 0, collected.stdout[-3000:]
    some = ["test/test_solvers.py", "test/test_qp.py", "test/test_launch.py", "test/test_steering.py"]
    done = subprocess.run([*run, *some], capture_output=True, check=False, **where)
    assert done.returncode == 0, done.stdout[-3000:]
    assert "which has no rosdep key" in done.stdout
    assert " passed" in done.stdout
