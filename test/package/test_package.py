"""The installed package: its metadata agree, and the result of colcon runs (``make colcon``)."""

from __future__ import annotations

import json
import os
import re
import runpy
import shlex
import shutil
import subprocess
import sys
import tomllib
import warnings
from collections.abc import Iterable
from importlib import metadata
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest

import dqwalk_ros
from dqwalk_ros.cli.runner import private_domain
from dqwalk_ros.support import imports
from dqwalk_ros.support.imports import how_to_install
from dqwalk_ros.support.node_table import NODES

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

    named = {how_to_install(module).removeprefix("pip install ") for module in imports._ON_PYPI}
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


PIP = "pip install "


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
    space, tools, sources = tmp_path / "ws", tmp_path / "tools", tmp_path / "sources"
    skipped = shutil.ignore_patterns(".*", "results", "build", "install", "log", "site", "*.egg-info", "__pycache__")
    shutil.copytree(ROOT, sources, ignore=skipped)
    identity = ["-c", "user.name=test", "-c", "user.email=test@example.org"]
    for words in (["init", "-q"], ["add", "-A"], [*identity, "commit", "-q", "-m", "sources"]):
        subprocess.run(["git", *words], cwd=sources, check=True)
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
        if (shutil.which(name) is None and name in ("sudo", "rosdep")) or ("/opt/ros" in line and not native):
            not_run.append(line)
        elif line.startswith("ros2 launch") and not native:
            not_run.append(line)
            if "bag:=walk" in line:
                run.append(
                    f"ros2 run dqwalk_ros dqwalk walk {CHEAP} --no-figures --quiet --out made && mv made/bag walk"
                )
        elif line.startswith("ros2 launch") and "lockstep" not in line:
            run.append(f"timeout --preserve-status -s INT 60 {line}")
        else:
            run.append(line.replace("REPOSITORY", str(sources)))
    # `ros2` is a program of the system's Python, which reads the launch files
    run.append(f"{Path(sys.base_prefix) / 'bin/python3'} -c 'import dqwalk_ros.config, dqwalk_ros.cli.options'")
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
    assert [file.name for file in (prefix / "bin").iterdir()] == ["dqwalk"]
    share = prefix / "share"
    assert (share / "ament_index" / "resource_index" / "packages" / "dqwalk_ros").is_file()
    for file in ("package.xml", "config/paper.yaml", "urdf/poppy.urdf", "launch/walk.launch.py"):
        assert (share / "dqwalk_ros" / file).is_file(), file
    report = outputs[run.index("dqwalk report walk")]
    assert "single_support/right" in report


# ---------------------------------------------------------------------- other ways of installing

ROS_BASE = {
    *("builtin_interfaces", "diagnostic_msgs", "geometry_msgs", "launch", "launch_ros", "nav_msgs", "rcl_interfaces"),
    *("rclpy", "robot_state_publisher", "rosgraph_msgs", "sensor_msgs", "std_msgs", "std_srvs", "tf2_msgs"),
    *("trajectory_msgs", "visualization_msgs"),
}
"""Keys of package.xml that the variant ros_base brings [REP-2001]."""
PIXI = tomllib.loads((ROOT / "pixi.toml").read_text(encoding="utf-8"))


def setup_arguments(monkeypatch: pytest.MonkeyPatch, *, colcon: bool) -> dict[str, Any]:
    """Return what setup.py passes to setuptools."""
    import setuptools

    given: dict[str, Any] = {}
    monkeypatch.setattr(setuptools, "setup", lambda **keywords: given.update(keywords))
    monkeypatch.chdir(ROOT)
    monkeypatch.setenv("COLCON", "1") if colcon else monkeypatch.delenv("COLCON", raising=False)
    runpy.run_path(str(ROOT / "setup.py"))
    return given


def names(requirements: Iterable[str], **marker: str) -> set[str]:
    from packaging.requirements import Requirement

    found = [Requirement(one) for one in requirements]
    return {one.name.replace("_", "-").lower() for one in found if not one.marker or one.marker.evaluate(marker)}


def with_their_own(wanted: set[str]) -> set[str]:
    """Return packages and all that pip installs with them."""
    from packaging.requirements import Requirement

    found, waiting = set[tuple[str, str]](), [(name, "") for name in wanted]
    while waiting:
        name, extra = one = waiting.pop()
        if one not in found:
            found.add(one)
            for each in map(Requirement, metadata.requires(name) or ()):
                if not each.marker or each.marker.evaluate({"extra": extra}):
                    waiting += [(each.name.replace("_", "-").lower(), own) for own in ("", *each.extras)]
    return {name for name, _ in found}


def test_a_workspace_of_colcon_has_dqwalk_on_its_path(monkeypatch: pytest.MonkeyPatch) -> None:
    """colcon adds the bin folder of a package to PATH; its console scripts are elsewhere. pip must not install two."""
    assert ("bin", ["bin/dqwalk"]) in setup_arguments(monkeypatch, colcon=True)["data_files"]
    assert not any(folder == "bin" for folder, _ in setup_arguments(monkeypatch, colcon=False)["data_files"])
    shown = subprocess.run([ROOT / "bin/dqwalk", "version"], capture_output=True, text=True, check=True, env=on_path())
    assert shown.stdout.startswith("dqwalk_ros ")


def on_path() -> dict[str, str]:
    return os.environ | {"PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"}


def test_rosdep_and_the_line_of_pip_bring_what_setup_py_requires(monkeypatch: pytest.MonkeyPatch) -> None:
    """README, package.xml and Dockerfile name the packages that have no key, and those of physics and of the page."""
    (line,) = (line for line in native_lines()[0] if line.startswith(PIP))
    words = shlex.split(line.removeprefix(PIP), comments=True)
    by_key = {"pyyaml" if key == "python3-yaml" else key.removeprefix("python3-") for key in keys()}
    required = names(setup_arguments(monkeypatch, colcon=True)["install_requires"]) - {"setuptools"}
    assert {"mujoco", "viser"} < names(words)
    assert required <= with_their_own(names(words)) | by_key
    assert names(words) - {"mujoco", "viser"} <= required - by_key | {"joblib"}
    for file, expected in (("Dockerfile", words), ("package.xml", words[:-2])):
        named = (ROOT / file).read_text(encoding="utf-8").partition(PIP)[2].removeprefix("--no-cache-dir ")
        assert named.startswith(" ".join(shlex.quote(word) for word in expected)), file


def test_the_container_is_built_by_the_lines_of_the_readme() -> None:
    text = (ROOT / "Dockerfile").read_text(encoding="utf-8").replace("--no-cache-dir ", "")
    for line in native_lines()[0]:
        for part in line.partition("  #")[0].split(" && "):
            if not part.startswith(("sudo apt", "git clone", "cd ", "dqwalk report")) and "bag:=walk" not in part:
                words = part.strip().replace("source ", ". ")
                assert words in text or str(words.split()).replace("'", '"') in text, part
    instructions = re.findall(r"^([A-Z]+) ", text, re.M)
    assert set(instructions) <= {"FROM", "SHELL", "WORKDIR", "COPY", "RUN", "ENTRYPOINT", "CMD"}
    assert instructions[0] == "FROM"
    for form in re.findall(r"^(?:SHELL|ENTRYPOINT|CMD) (.*)$", text, re.M):
        assert isinstance(json.loads(form), list)


def test_pixi_brings_what_package_xml_and_setup_py_require(monkeypatch: pytest.MonkeyPatch) -> None:
    extras = setup_arguments(monkeypatch, colcon=False)["extras_require"]
    conda = set(PIXI["dependencies"]) | {
        name for one in PIXI["feature"].values() for name in one.get("dependencies", ())
    }
    own = PIXI["pypi-dependencies"]["dqwalk_ros"]
    assert (own["path"], own["editable"]) == (".", True)
    python = names(metadata.requires("dqwalk_ros") or (), extra="poppy")
    for key in keys() - ROS_BASE:
        plain = {"python3-yaml": "pyyaml", "python3-serial": "pyserial"}.get(key, key.removeprefix("python3-"))
        plain = plain.replace("_", "-")
        tests = names(extras["test"])
        assert f"ros-jazzy-{plain}" in conda or plain in python | tests, key
    assert {"sim", "view", "poppy"} <= set(own["extras"]) <= set(extras)
    assert set(PIXI["feature"]["test"]["pypi-dependencies"]["dqwalk_ros"]["extras"]) <= set(extras)
    assert {name for given in PIXI["environments"].values() for name in given} == set(PIXI["feature"])
    assert {"walk", "demo"} <= set(PIXI["tasks"])
    assert "test" in PIXI["feature"]["test"]["tasks"]


WHEELS = {
    "linux-aarch64": ("aarch64", [f"manylinux_2_{minor}_aarch64" for minor in (17, 24, 26, 27, 28)]),
    "osx-arm64": ("arm64", ["macosx_14_0_arm64"]),
}
"""Machine and tags of wheels of the platforms of pixi.toml; this environment shows those of linux-64."""


@pytest.mark.long
@pytest.mark.timeout(900)
@pytest.mark.parametrize("platform", WHEELS)
@pytest.mark.parametrize("environment", ["default", "test"])
def test_every_requirement_has_a_wheel_for_the_platforms_of_pixi(
    platform: str, environment: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    from packaging.requirements import Requirement

    assert {"linux-64", *WHEELS} == set(PIXI["workspace"]["platforms"])
    machine, tags = WHEELS[platform]
    arguments = setup_arguments(monkeypatch, colcon=False)
    own = (PIXI if environment == "default" else PIXI["feature"][environment])["pypi-dependencies"]["dqwalk_ros"]
    given = [
        *arguments["install_requires"],
        *(one for name in own["extras"] for one in arguments["extras_require"][name]),
    ]
    found = [Requirement(one) for one in given]
    wanted = [
        f"{one.name}[{','.join(one.extras)}]{one.specifier}"
        for one in found
        if not one.marker or one.marker.evaluate({"platform_machine": machine})
    ]
    pip = [sys.executable, "-m", "pip", "install", "--dry-run", "--quiet", "--no-deps", "--only-binary", ":all:"]
    pip += ["--python-version", "3.12", "--target", str(tmp_path), *(f"--platform={tag}" for tag in tags)]
    done = subprocess.run(
        [*pip, *(one.replace("[]", "") for one in wanted)], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr[-2000:]


def test_make_says_what_to_do_without_wheels_of_ros(tmp_path: Path) -> None:
    """As on a Raspberry Pi."""
    (tmp_path / "sitecustomize.py").write_text("import platform\nplatform.machine = lambda: 'aarch64'\n")
    base = Path(sys.base_prefix) / "bin/python3"
    (tmp_path / "python").write_text(f'#!/bin/sh\nPYTHONPATH={tmp_path} exec {base} "$@"\n')
    (tmp_path / "python").chmod(0o755)
    words = ["make", "venv", f"PYTHON={tmp_path / 'python'}", f"VENV={tmp_path / 'venv'}"]
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    done = subprocess.run(words, cwd=ROOT, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode
    assert "this is Linux on aarch64" in done.stderr
    assert all(way in done.stderr for way in ("/opt/ros/jazzy/setup.bash", "pixi run walk", "docker build"))
    assert not (tmp_path / "venv").exists()
    (tmp_path / "rclpy.py").write_text("")  # a ROS is sourced
    done = subprocess.run(
        ["make", "-n", *words[1:]], cwd=ROOT, env=environment, capture_output=True, text=True, check=True
    )
    assert "-m venv --system-site-packages" in done.stdout
    assert "--editable '.[commands]'" in done.stdout


STAND_IN = """#!/bin/bash
# instead of python: it makes an environment whose pip bears no second one at the same time
case "$*" in
    *"-m venv"*) mkdir -p "$3/bin" && cp "$0" "$3/bin/python" && echo "command = x -m venv $PWD/$3" > "$3/pyvenv.cfg"
         touch "$3/bin/pip" ;;
    *"-m pip"*) mkdir pip && sleep 0.2 && rmdir pip ;;
esac
"""


def test_make_mends_half_an_environment_and_notices_that_of_another_folder(tmp_path: Path) -> None:
    """The programs in a copied folder would run the code of the original; with -j one pip runs at a time."""
    (first := tmp_path / "first").mkdir()
    for name in ("Makefile", "setup.py"):
        shutil.copy(ROOT / name, first)
    (tmp_path / "python").write_text(STAND_IN)
    (tmp_path / "python").chmod(0o755)

    def make(folder: Path, *words: str) -> subprocess.CompletedProcess[str]:
        command = ["make", *words, f"PYTHON={tmp_path / 'python'}"]
        own = {name: value for name, value in os.environ.items() if not name.startswith("MAKE")}  # of `make test`
        return subprocess.run(command, cwd=folder, env=own, capture_output=True, text=True, check=False)

    both = [f".venv/.installed-{name}" for name in ("sim", "drake")]
    assert make(first, "-j8", *both).returncode == 0
    (first / ".venv/bin/pip").unlink()  # the environment was interrupted while it was made
    (first / both[0]).unlink()
    assert make(first, both[0]).returncode == 0
    assert (first / ".venv/bin/pip").exists()
    shutil.copytree(first, tmp_path / "copy")
    assert "*** .venv was made in another folder: rm -rf .venv, then make" in make(tmp_path / "copy", "lint").stderr
    assert make(tmp_path / "copy").stdout.startswith("usage: make TARGET")


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
robot_state_publisher rosgraph_msgs rviz2 sensor_msgs std_msgs std_srvs tf2_msgs trajectory_msgs visualization_msgs
xacro python3-click python3-collada python3-hypothesis python3-joblib python3-matplotlib python3-numba python3-numpy
python3-psutil python3-pytest python3-pytest-timeout python3-pytest-xdist python3-rich python3-scipy python3-serial
python3-tqdm python3-yaml
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
