"""The rings: a module imports only from rings above its own, without circles, and heavy dependencies in few rings."""

from __future__ import annotations

import ast
import re
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PACKAGE = ROOT / "dqwalk_ros"

RINGS = (
    "support",
    "config",
    "paper",
    "robot",
    "estimation",
    "controller",
    "walks",
    "plants",
    "trace",
    "simulation",
    "report",
    "identification",
    "studies",
    "adopt",
    "nodes",
    "whole_body",
    "cli",
    "programs",
)
"""From the top down: folders of the package, and the files on its root floor."""

IMPORTERS = {
    "clarabel": {"paper"},
    "daqp": {"paper", "whole_body"},
    "dynamixel_sdk": {"plants"},
    "matplotlib": {"adopt", "report", "whole_body"},
    "mujoco": {"plants", "report", "adopt", "whole_body"},
    "numba": {"support"},
    "pinocchio": {"whole_body"},
    "rclpy": {"nodes", "whole_body"},
    "viser": {"report"},
}
"""The only rings that may import dependencies that are heavy or optional."""

FILES = sorted(PACKAGE.rglob("*.py"))


def ring(file: Path) -> str:
    return file.relative_to(PACKAGE).parts[0].removesuffix(".py")


@cache
def tree_of(file: Path) -> ast.Module:
    return ast.parse(file.read_text(encoding="utf-8"))


@cache
def imports(file: Path, types: bool = False) -> list[str]:
    """Return every module a file imports, also within functions; those for type checking only with `types`."""
    found, waiting = [], [tree_of(file)]
    while waiting:
        node = waiting.pop()
        checking = isinstance(node, ast.If) and isinstance(node.test, ast.Name) and node.test.id == "TYPE_CHECKING"
        if checking and not types:
            continue
        waiting += [
            inner
            for inner in ast.iter_child_nodes(node)
            if isinstance(inner, ast.stmt | ast.ExceptHandler | ast.match_case)
        ]
        if isinstance(node, ast.Import):
            found += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{file}: imports are absolute"
            found += [f"{node.module}.{alias.name}" for alias in node.names]
    return found


def test_every_module_is_in_a_ring():
    assert {ring(file) for file in FILES} - {"__init__", "__main__"} <= set(RINGS)


def test_the_map_names_every_module():
    """But for the commands, which `dqwalk --help` lists."""
    words = set(re.findall(r"\w+", (ROOT / "docs/architecture.md").read_text(encoding="utf-8")))
    assert {file.stem for file in FILES if not file.stem.startswith("__") and ring(file) != "cli"} <= words


def test_the_root_floor_is_small():
    assert len(list(PACKAGE.glob("*.py"))) <= 8


def test_a_module_imports_only_rings_above_its_own():
    wrong = []
    for file in FILES:
        if ring(file) == "__init__":
            continue  # names only, loaded on first use
        for name in imports(file):
            package, _, rest = name.partition(".")
            if package == "dqwalk_ros" and rest not in ("__version__",):
                above = rest.split(".")[0]
                if RINGS.index(above) > RINGS.index(ring(file)):
                    wrong.append(f"{file.relative_to(PACKAGE)} imports {name}, which is below it")
    assert not wrong


def module(file: Path) -> str:
    """Return the dotted name of a file below the package."""
    return ".".join(file.relative_to(PACKAGE.parent).with_suffix("").parts).removesuffix(".__init__")


@cache
def needed(types: bool = False) -> dict[str, set[str]]:
    """Return the modules of the package that each one imports, as `imports` does; the names of a package are lazy."""
    files = {module(file): file for file in FILES}
    return {
        name: {
            found
            for text in imports(file, types and file.name != "__init__.py")
            for found in (text, text.rpartition(".")[0])
            if found in files
        }
        - {name}
        for name, file in files.items()
        if file.name != "__init__.py" or "import_module" not in file.read_text(encoding="utf-8")
    }


def test_no_circle_of_imports():
    """Also inside a folder, of imports within functions, and of those for type checking."""
    todo = dict(needed(types=True))
    while done := [name for name, others in todo.items() if not others & todo.keys()]:
        for name in done:
            del todo[name]
    assert not todo


@pytest.mark.parametrize("node", ["controller", "plant", "drive", "poppy_driver"])
def test_a_node_that_moves_the_robot_does_not_load_what_judges_the_walk(node):
    found, waiting = set(), {f"dqwalk_ros.nodes.{node}"}
    while waiting:
        found |= waiting
        waiting = set().union(*(needed()[name] for name in waiting)) - found
    assert not [name for name in found if name.startswith(("dqwalk_ros.report", "dqwalk_ros.studies"))]


@pytest.mark.parametrize("package", IMPORTERS)
def test_heavy_dependencies_are_imported_in_their_rings_only(package):
    importers = {ring(file) for file in FILES if any(name.split(".")[0] == package for name in imports(file))}
    assert importers <= IMPORTERS[package]


def test_files_are_not_too_long():
    """Also those of tests and benchmarks."""
    files = [file for folder in (PACKAGE, ROOT / "test", ROOT / "benchmark") for file in folder.rglob("*.py")]
    lines = {str(file.relative_to(ROOT)): len(file.read_text(encoding="utf-8").splitlines()) for file in files}
    too_long = {name: n for name, n in lines.items() if n > 700}
    assert not too_long, "split these files into folders"


def test_a_name_with_an_underscore_is_used_in_its_own_module():
    names = {name: file for file in FILES for name in imports(file) if name.startswith("dqwalk_ros.")}
    private = {name: file for name, file in names.items() if re.match(r"_[^_]", name.rpartition(".")[2])}
    assert not private
