"""The installed package: its metadata agree, and the result of colcon runs (``make colcon``)."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import warnings
from importlib import metadata
from pathlib import Path
from xml.etree import ElementTree

import pytest

import dqwalk_ros
from dqwalk_ros.cli.runner import private_domain
from dqwalk_ros.nodes.command_line import NODES
from dqwalk_ros.support import errors
from dqwalk_ros.support.errors import how_to_install

ROOT = Path(__file__).resolve().parents[2]


def test_all_files_give_the_same_version() -> None:
    version = dqwalk_ros.__version__
    assert ElementTree.parse(ROOT / "package.xml").findtext("version") == version
    assert f'version="{version}"' in (ROOT / "setup.py").read_text(encoding="utf-8")
    assert f"\nversion: {version}\n" in (ROOT / "CITATION.cff").read_text(encoding="utf-8")


def test_every_node_is_installed() -> None:
    """setup.py installs all scripts, because it cannot import the package."""
    assert sorted(file.name for file in (ROOT / "scripts").iterdir()) == sorted(NODES)
    for name in NODES:
        script = ROOT / "scripts" / name
        assert script.stat().st_mode & 0o111, f"{script} cannot be executed"
        assert script.read_bytes() == (ROOT / "scripts/controller").read_bytes()
    # the node is that of the name of the file
    how = {"cwd": ROOT, "env": os.environ | {"PYTHONPATH": str(ROOT)}, "capture_output": True, "text": True}
    shown = subprocess.run([sys.executable, script, "--help"], **how, check=True).stdout
    assert shown.startswith(f"usage: dqwalk_{name} ")


def test_packages_to_install_are_those_of_setup_py() -> None:
    """The name on PyPI that an error gives is one that an extra installs."""
    from packaging.requirements import Requirement

    named = {how_to_install(module).removeprefix("pip install ") for module in errors._ON_PYPI}
    assert named <= {Requirement(one).name for one in metadata.requires("dqwalk_ros") or ()}


def test_package_xml_declares_what_the_nodes_import() -> None:
    declared = {e.text for e in ElementTree.parse(ROOT / "package.xml").iter() if e.tag.endswith("depend")}
    imported = set()
    for file in (ROOT / "dqwalk_ros").glob("**/nodes/*.py"):
        imported |= set(
            re.findall(r"^\s*(?:from|import) (\w+(?:_msgs|_srvs|_interfaces)|rclpy)\b", file.read_text(), re.M)
        )
    assert imported <= declared, imported - declared


# ---------------------------------------------------------------------- README, "On a machine with ROS 2 Jazzy"

CHEAP = "--set task.eta=1.0 --set gait.step_length=0.02 --set ssp.threshold=0.02 --set dsp.stall_rate=0.003"


def native_lines() -> tuple[list[str], str]:
    """Return the lines of README's native installation, and the one that starts a single node."""
    text = (ROOT / "README.md").read_text(encoding="utf-8").partition("## On a machine with ROS 2 Jazzy")[2]
    block = re.search(r"```bash\n(.*?)```", text, re.S)
    single_node = re.search(r"`(ros2 run dqwalk_ros controller .*?)`", text)
    assert block
    assert single_node
    return block[1].splitlines(), single_node[1]


def make_underlay(folder: Path, python: str) -> None:
    """Fill a folder with the packages of a machine with ROS: its Python packages, colcon, and those of rosdep.

    Only declared packages: the wheels of ROS, and the keys of package.xml.
    """
    from packaging.requirements import Requirement

    alias = {"yaml": "pyyaml", "serial": "pyserial"}
    waiting = [alias.get(key.removeprefix("python3-"), key.removeprefix("python3-")) for key in keys()]
    ros = [Requirement(one) for one in metadata.requires("dqwalk_ros") or ()]
    waiting += [one.name for one in ros if one.marker and one.marker.evaluate({"extra": "ros"})]
    found: dict[str, metadata.Distribution] = {}
    while waiting:
        name = waiting.pop().replace("_", "-").lower()
        try:
            found[name] = metadata.distribution(name)
        except metadata.PackageNotFoundError:  # a package of ROS under its own name
            continue
        needs = [Requirement(one) for one in found[name].requires or ()]
        extra = {"extra": "fastrtps"}
        waiting += [r.name for r in needs if r.name not in found and (not r.marker or r.marker.evaluate(extra))]
    command = [python, "-m", "pip", "install", "--quiet", "--target", str(folder)]
    subprocess.run([*command, "colcon-common-extensions", "setuptools<80"], check=True)
    if sys.version_info < (3, 12):  # a virtual environment contains its own then
        for one in ("setuptools", "pkg_resources", "_distutils_hack", "setuptools-*"):
            for place in folder.glob(one):
                shutil.rmtree(place)
    for distribution in found.values():
        for top in {file.parts[0] for file in distribution.files or ()} - {"..", "__pycache__"}:
            source = Path(str(distribution.locate_file(top)))
            if source.exists() and not (folder / top).exists():
                (folder / top).symlink_to(source)


@pytest.mark.colcon
@pytest.mark.timeout(1800)
def test_the_native_installation_of_the_readme_works(tmp_path: Path) -> None:
    """Every line runs in one shell on a copy of the sources; lines that need a missing ROS are listed as not run.

    With the wheels, PYTHONPATH holds the packages of such a machine, and `ros2` supports only `run`.
    """
    space, tools = tmp_path / "ws", tmp_path / "tools"
    skipped = shutil.ignore_patterns(".*", "results", "build", "install", "log", "site", "*.egg-info", "__pycache__")
    shutil.copytree(ROOT, space / "src" / "dqwalk_ros", ignore=skipped)
    tools.mkdir()
    path = [str(tools), str(Path(sys.executable).parent), os.environ["PATH"]]
    environment = {key: value for key, value in os.environ.items() if key not in ("VIRTUAL_ENV", "COLCON")}
    environment |= {"HOME": str(tmp_path), "PATH": os.pathsep.join(path), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
    environment |= {"XDG_CACHE_HOME": os.environ.get("XDG_CACHE_HOME", str(Path.home() / ".cache"))}
    environment["NUMBA_DISABLE_JIT"] = "1"  # compilation takes a minute and is not tested here
    native = shutil.which("ros2") is not None
    if not native:
        (tools / "ros2").write_text(
            "#!/bin/sh\n# ros2 run PACKAGE EXECUTABLE ...\npackage=$2 executable=$3; shift 3\n"
            'for prefix in $(echo "$AMENT_PREFIX_PATH" | tr : " "); do\n'
            '    [ -x "$prefix/lib/$package/$executable" ] && exec "$prefix/lib/$package/$executable" "$@"\n'
            'done\necho "No executable found" >&2; exit 1\n'
        )
        (tools / "ros2").chmod(0o755)
        make_underlay(tmp_path / "underlay", sys.executable)
        environment |= {"PYTHONPATH": str(tmp_path / "underlay"), "AMENT_PREFIX_PATH": sys.prefix}

    lines, single_node = native_lines()
    run, not_run = [], []
    for line in lines:
        name = line.split()[0]
        if name == "rosdep" and shutil.which("rosdep") is None:
            not_run.append(line)
        elif line.startswith("ros2 launch") and not native:
            not_run.append(line)
            run.append(f"ros2 run dqwalk_ros dqwalk walk {CHEAP} --no-figures --quiet --out made && mv made/bag walk")
        else:
            run.append(line)
    for node in ("controller", "integrator", "phase_monitor", "recorder --bag recorded"):
        run.append("timeout --preserve-status -s INT 30 " + single_node.replace("controller", node, 1))
    run += [f"ros2 run dqwalk_ros {node} --help | grep Example:" for node in NODES]

    script = tmp_path / "script"
    script.write_text("exec 2>&1\n" + "".join(f'{line}\necho "@@ $?"\n' for line in run))
    with private_domain() as domain:
        environment["ROS_DOMAIN_ID"] = str(domain)
        done = subprocess.run(
            ["bash", script], env=environment, cwd=tmp_path, stdout=subprocess.PIPE, text=True, check=False
        )
    outputs = done.stdout.split("@@ ")
    for line, before, after in zip(run, outputs, outputs[1:], strict=False):
        print(f"$ {line}\n{before.partition(chr(10))[2] if run.index(line) else before}")
        assert after.split()[0] == "0", line
    assert len(outputs) == len(run) + 1
    for line in not_run:
        warnings.warn(f"not run, there is no ROS: {line}", stacklevel=1)

    prefix = space / "install" / "dqwalk_ros"
    assert sorted(file.name for file in (prefix / "lib" / "dqwalk_ros").iterdir()) == sorted(["dqwalk", *NODES])
    share = prefix / "share"
    assert (share / "ament_index" / "resource_index" / "packages" / "dqwalk_ros").is_file()
    for file in ("package.xml", "config/paper.yaml", "urdf/poppy.urdf", "launch/walk.launch.py"):
        assert (share / "dqwalk_ros" / file).is_file(), file
    report = outputs[run.index("ros2 run dqwalk_ros dqwalk report walk")]
    assert "single_support/right" in report


def test_the_aggregator_lists_every_status() -> None:
    import yaml

    tree = yaml.safe_load((ROOT / "config" / "diagnostics_aggregator.yaml").read_text())["/**"]["ros__parameters"]
    known = {name for one in tree.values() if isinstance(one, dict) for name in one["contains"]}
    assert {name.partition(":")[0] for name in known} <= set(NODES)
    published = set()
    for file in (ROOT / "dqwalk_ros").glob("**/nodes/*.py"):
        published |= set(re.findall(r"\.diagnose\(\s*\"(\w+)\"", file.read_text(encoding="utf-8")))
    assert {name.partition(": ")[2] for name in known} >= published


# ---------------------------------------------------------------------- rosdep

KNOWN = "2026-08-22"
KEYS = """
builtin_interfaces diagnostic_msgs dynamixel_sdk geometry_msgs launch launch_ros nav_msgs rcl_interfaces rclpy
rosgraph_msgs sensor_msgs std_msgs std_srvs tf2_msgs trajectory_msgs visualization_msgs xacro python3-click
python3-collada python3-hypothesis python3-joblib python3-matplotlib python3-numba python3-numpy
python3-psutil python3-pytest python3-pytest-timeout python3-pytest-xdist python3-rich
python3-scipy python3-serial python3-tqdm python3-yaml
"""
"""Keys of rosdistro on that day: packages of Jazzy, and rosdep/python.yaml."""
ROSDISTRO = "https://raw.githubusercontent.com/ros/rosdistro/master/"


def keys() -> set[str]:
    return {e.text or "" for e in ElementTree.parse(ROOT / "package.xml").iter() if e.tag.endswith("depend")}


def test_every_dependency_has_a_rosdep_key() -> None:
    """With one unknown key `rosdep install` installs nothing."""
    known = set(KEYS.split())
    assert keys() <= known, f"look {keys() - known} up in rosdistro, then add it to the table"


@pytest.mark.long
def test_rosdistro_still_has_the_keys() -> None:
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
    """As in `colcon test` where nothing else is installed; one undeclared import stops the collection."""
    run = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "-p", "declared"]
    where = {"cwd": ROOT, "env": {**os.environ, "PYTHONPATH": f"{ROOT}:{ROOT / 'test'}"}, "text": True}
    collected = subprocess.run([*run, "--co", "test"], capture_output=True, check=False, **where)
    assert collected.returncode == 0, collected.stdout[-3000:]
    some = [
        "test/paper/test_solvers.py",
        "test/paper/test_qp.py",
        "test/package/test_launch.py",
        "test/walks/test_steering.py",
    ]
    done = subprocess.run([*run, *some], capture_output=True, check=False, **where)
    assert done.returncode == 0, done.stdout[-3000:]
    assert "which has no rosdep key" in done.stdout
    assert " passed" in done.stdout
