"""The layers: a module imports only modules above it, and each heavy dependency is imported in few layers."""

from __future__ import annotations

import ast
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
PACKAGE = ROOT / "dqwalk_ros"

LAYERS = (
    "arrays",
    "errors",
    "interrupts",
    "own_folder",
    "provenance",
    "strict_yaml",
    "text_table",
    "topics",
    "config",
    "overlay",
    "compiled",
    "dual_quaternions",
    "geometry",
    "packages",
    "urdf",
    "shapes",
    "robot",
    "servos",
    "state",
    "kinematics",
    "constraints",
    "tasks",
    "paths",
    "targets",
    "qp",
    "assembly",
    "statics",
    "stability",
    "estimation",
    "walk",
    "controller",
    "plants",
    "standing",
    "dynamic",
    "simulation",
    "whole_body",
    "report",
    "identification",
    "studies",
    "adopt",
    "nodes",
    "runner",
    "cli",
)
"""From the top down; a folder is one layer."""

IMPORTERS = {
    "clarabel": {"qp"},
    "daqp": {"qp", "whole_body"},
    "dynamixel_sdk": {"plants"},
    "matplotlib": {"adopt", "report"},
    "mujoco": {"plants", "report", "whole_body"},
    "numba": {"compiled"},
    "pinocchio": {"whole_body"},
    "rclpy": {"nodes"},
    "viser": {"report"},
}
"""The only layers that may import dependencies that are heavy or optional."""

FILES = sorted(PACKAGE.rglob("*.py"))


def layer(file: Path) -> str:
    return file.relative_to(PACKAGE).parts[0].removesuffix(".py")


@cache
def imports(file: Path) -> list[str]:
    """Return every module a file imports, also within functions, except for type checking."""
    tree = ast.parse(file.read_text(encoding="utf-8"))
    skipped = {
        id(inner)
        for node in ast.walk(tree)
        if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING"
        for inner in ast.walk(node)
    }
    found = []
    for node in ast.walk(tree):
        if id(node) in skipped:
            continue
        if isinstance(node, ast.Import):
            found += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{file}: imports are absolute"
            found += [f"{node.module}.{alias.name}" for alias in node.names]
    return found


def test_every_module_is_in_a_layer():
    assert {layer(file) for file in FILES} - {"__init__", "__main__"} <= set(LAYERS)


def test_a_module_imports_only_modules_above_it():
    wrong = []
    for file in FILES:
        if layer(file) == "__init__":
            continue  # names only, loaded on first use
        for name in imports(file):
            package, _, rest = name.partition(".")
            if package == "dqwalk_ros" and rest not in ("__version__",):
                above = rest.split(".")[0]
                if LAYERS.index(above) > LAYERS.index(layer(file)):
                    wrong.append(f"{file.relative_to(PACKAGE)} imports {name}, which is below it")
    assert not wrong


@pytest.mark.parametrize("package", IMPORTERS)
def test_heavy_dependencies_are_imported_in_their_layers_only(package):
    importers = {layer(file) for file in FILES if any(name.split(".")[0] == package for name in imports(file))}
    assert importers <= IMPORTERS[package]


def test_files_are_not_too_long():
    """The parameter schema is a table and may be longer."""
    lines = {str(file.relative_to(PACKAGE)): len(file.read_text(encoding="utf-8").splitlines()) for file in FILES}
    too_long = {name: n for name, n in lines.items() if n > (800 if name == "config.py" else 700)}
    assert not too_long, "split these files into folders"


def test_public_names_have_docstrings():
    """Also those that ``__all__`` does not list, which ruff leaves out."""
    missing = []
    for file in FILES:
        tree = ast.parse(file.read_text(encoding="utf-8"))
        public = [n for n in tree.body if isinstance(n, ast.FunctionDef | ast.ClassDef) and not n.name.startswith("_")]
        missing += [f"{file.name}: {node.name}" for node in public if not ast.get_docstring(node)]
        missing += [file.name] if tree.body and not ast.get_docstring(tree) else []
    assert not missing
