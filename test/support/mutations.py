"""Changes each safety-relevant line, one at a time, and checks whether a test fails (`make mutation`).

A mutant is one changed operator, number or function of a file. Its tests run in a child process that uses the changed
file instead of the original. Surviving mutants are listed; docs/results/faults.md explains them, or a test is missing.

Usage: python test/support/mutations.py [--every N] [--only TEXT] [--again OUTPUT] [FILE ...]
"""

from __future__ import annotations

import argparse
import ast
import copy
import importlib
import os
import resource
import subprocess
import sys
import tempfile
import time
import types
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
TARGETS = {
    "dqwalk_ros/nodes/watchdog.py": ("nodes/test_watchdog.py", "nodes/test_state_gate.py"),
    "dqwalk_ros/nodes/joint_order.py": ("nodes/test_joint_order.py",),
    "dqwalk_ros/nodes/publishers.py": ("nodes/test_publishers.py",),
    "dqwalk_ros/nodes/command_gate.py": ("nodes/test_command_gate.py",),
    "dqwalk_ros/nodes/state_gate.py": ("nodes/test_state_gate.py", "nodes/test_inertial_gate.py"),
    "dqwalk_ros/nodes/velocity_gate.py": ("nodes/test_state_gate.py",),
    "dqwalk_ros/nodes/inertial_gate.py": ("nodes/test_inertial_gate.py",),
    "dqwalk_ros/whole_body/nodes/body_gate.py": ("whole_body/test_body_gate.py",),
    "dqwalk_ros/nodes/phase_log.py": ("nodes/test_phase_log.py",),
    "dqwalk_ros/report/viewer/guard.py": ("report/test_viewer.py",),
    "dqwalk_ros/nodes/inertial_sensor.py": ("nodes/test_inertial_sensor.py",),
    "dqwalk_ros/nodes/fall_watch.py": ("nodes/test_fall_watch.py", "faults/test_liars.py"),
    "dqwalk_ros/nodes/answering.py": ("nodes/test_answering.py",),
    "dqwalk_ros/nodes/drive.py": ("nodes/test_drive.py", "nodes/test_drive_stops.py", "faults/test_drive_battery.py"),
    "dqwalk_ros/nodes/pilot.py": ("nodes/test_pilot.py",),
    "dqwalk_ros/nodes/recorder.py": (
        "faults/test_attacks.py",
        "nodes/test_listening.py",
        "interop/test_interoperability.py",
    ),
    "dqwalk_ros/robot/limits.py": ("robot/test_limits.py", "plants/test_servo_goals.py"),
    "dqwalk_ros/plants/servo_goals.py": ("plants/test_servo_goals.py",),
    "dqwalk_ros/walks/dynamic/recovery.py": ("walks/test_recovery.py",),
    "dqwalk_ros/estimation/base.py": ("estimation/test_base.py",),
    "dqwalk_ros/estimation/load.py": ("estimation/test_load.py",),
    "dqwalk_ros/estimation/delay.py": ("estimation/test_delay.py", "plants/test_servo_goals.py"),
    "dqwalk_ros/plants/poppy/dynamixel.py": ("plants/test_poppy_faults.py", "plants/test_poppy.py"),
    "dqwalk_ros/plants/poppy/motor_watch.py": (
        "plants/test_motor_watch.py",
        "plants/test_poppy_faults.py",
        "plants/test_poppy.py",
    ),
    "dqwalk_ros/plants/poppy/motors.py": ("plants/test_poppy.py",),
    **dict.fromkeys(
        ("dqwalk_ros/plants/poppy/plant.py", "dqwalk_ros/plants/poppy/buses.py"),
        ("plants/test_poppy_faults.py", "plants/test_poppy.py", "faults/test_poppy_battery.py"),
    ),
}
"""Files, and the tests that must detect their mutants. Files with compiled functions are run uncompiled."""
SLOW = "battery or close_releases"
WALKS = "ends_the_walk or through_ros2_control or controller_killed or is_caught or walk_is_the_same or covariance"
STAGES = f"not ({WALKS} or {SLOW})", SLOW
"""Selections of tests, in order: the slow ones run if all others pass; those that walk take too long."""
WARM = ("hypothesis", "rclpy.node", "sensor_msgs.msg", "mujoco", "msgspec", "scipy.sparse", "yourdfpy")
"""Imported once, before the first fork; none of these imports a target, or numba."""
LONGEST = 120, 900.0
"""A mutant that takes longer counts as detected: time of the processor, and of the clock if it waits for ever [s]."""
SWAPPED: dict[type[ast.AST], tuple[type[ast.AST], ...]] = {
    ast.Lt: (ast.LtE, ast.GtE),
    ast.LtE: (ast.Lt, ast.Gt),
    ast.Gt: (ast.GtE, ast.LtE),
    ast.GtE: (ast.Gt, ast.Lt),
    ast.Eq: (ast.NotEq,),
    ast.NotEq: (ast.Eq,),
    ast.Add: (ast.Sub,),
    ast.Sub: (ast.Add,),
    ast.Mult: (ast.Div,),
    ast.Div: (ast.Mult,),
    ast.And: (ast.Or,),
    ast.Or: (ast.And,),
    ast.BitAnd: (ast.BitOr,),
    ast.BitOr: (ast.BitAnd,),
}
NAMES = {"min": "max", "max": "min", "minimum": "maximum", "maximum": "minimum", "any": "all", "all": "any"}


def mutants(source: str) -> Iterator[tuple[int, str, ast.Module]]:
    """Yield line, description of the change, and the changed module."""
    tree = ast.parse(source)
    kept = {id(part) for node in ast.walk(tree) for part in without_effect(node)}
    count = len(list(ast.walk(tree)))
    for k in range(count):
        before = list(ast.walk(tree))[k]
        if id(before) in kept:
            continue
        for change in changes(before):
            changed = copy.deepcopy(tree)
            node = list(ast.walk(changed))[k]
            change(node)
            yield getattr(before, "lineno", 0), f"{ast.unparse(before)}  ->  {ast.unparse(node)}", changed


def without_effect(node: ast.AST) -> Iterator[ast.AST]:
    """Yield the parts of a node whose change cannot move a robot: texts of messages, annotations and decorators."""
    if isinstance(node, ast.JoinedStr):
        yield from ast.walk(node)
    annotations = [getattr(node, name, None) for name in ("annotation", "returns")]
    for part in (*filter(None, annotations), *getattr(node, "decorator_list", ())):
        yield from ast.walk(part)


def changes(node: ast.AST) -> Iterator[object]:
    """Yield functions that change a node of this kind in place."""
    if isinstance(node, ast.Compare):
        for k, op in enumerate(node.ops):
            for other in SWAPPED.get(type(op), ()):
                yield lambda n, k=k, other=other: n.ops.__setitem__(k, other())
    elif isinstance(node, ast.BinOp | ast.BoolOp | ast.AugAssign):
        for other in SWAPPED.get(type(node.op), ()):
            yield lambda n, other=other: setattr(n, "op", other())
    elif isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub):
        yield lambda n: setattr(n, "op", ast.UAdd())
    elif isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.Not):
        yield lambda n: setattr(n, "operand", ast.UnaryOp(ast.Not(), n.operand))
    elif isinstance(node, ast.Constant) and type(node.value) in (int, float) and node.value:
        yield lambda n: setattr(n, "value", 2 * n.value)
    elif isinstance(node, ast.Constant) and isinstance(node.value, bool):
        yield lambda n: setattr(n, "value", not n.value)
    elif isinstance(node, ast.Name) and node.id in NAMES:
        yield lambda n: setattr(n, "id", NAMES[n.id])
    elif isinstance(node, ast.Attribute) and node.attr in NAMES:
        yield lambda n: setattr(n, "attr", NAMES[n.attr])


def survives(file: str, changed: ast.Module) -> bool:
    """Return whether all tests of a changed file pass."""
    return all(failure(file, changed, stage) is None for stage in STAGES)


def failure(file: str, changed: ast.Module, stage: str) -> str | None:
    """Run the tests of a stage against a changed file in a child process; return why they fail, None if they pass."""
    with tempfile.TemporaryFile() as output:
        failed = run(file, changed, stage, output.fileno())
        output.seek(0)
        return failed and f"{failed}\n{output.read().decode(errors='replace')[-3000:]}"


def run(file: str, changed: ast.Module, stage: str, output: int) -> str | None:
    """As `failure`; the output of the tests goes to a file descriptor."""
    if (child := os.fork()) == 0:
        os.dup2(output, 1)
        os.dup2(output, 2)
        code = 1
        try:
            resource.setrlimit(resource.RLIMIT_CPU, (LONGEST[0], LONGEST[0]))
            if "@jit" in (ROOT / file).read_text(encoding="utf-8"):  # else the code compiled of the original would run
                os.environ["NUMBA_DISABLE_JIT"] = "1"
            name = file.removesuffix(".py").replace("/", ".")
            module = types.ModuleType(name)
            module.__file__ = str(ROOT / file)
            importlib.import_module(name.rpartition(".")[0])
            sys.modules[name] = module
            exec(compile(ast.fix_missing_locations(changed), file, "exec"), module.__dict__)
            setattr(sys.modules[name.rpartition(".")[0]], name.rpartition(".")[2], module)
            files = [str(ROOT / "test" / test) for test in TARGETS[file]]
            own = ["-q", "-x", "-p", "no:cacheprovider", f"--basetemp={tempfile.mkdtemp()}/t"]
            code = pytest.main([*own, "-k", stage, *files])
        finally:
            os._exit(int(code))
    end = time.monotonic() + LONGEST[1]
    while time.monotonic() < end:
        done, status = os.waitpid(child, os.WNOHANG)
        if done:
            code = os.waitstatus_to_exitcode(status)
            return None if code in (0, pytest.ExitCode.NO_TESTS_COLLECTED) else f"exit code {code}"
        time.sleep(0.02)
    os.kill(child, 9)
    os.waitpid(child, 0)
    return f"not done after {LONGEST[1]:g} s"


def main() -> int:
    """Print the survivors; return 1 if there are any."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("files", nargs="*", default=list(TARGETS))
    parser.add_argument("--every", type=int, default=1, help="test every N-th mutant only")
    parser.add_argument("--only", default="", help="only changes that contain this text")
    parser.add_argument("--again", metavar="OUTPUT", help="only the survivors in the saved output of an earlier run")
    options = parser.parse_args()
    sys.path.insert(0, str(ROOT / "test" / "support"))
    subprocess.run([sys.executable, "-c", "import warm; warm.compile_all()"], cwd=ROOT / "test/support", check=True)
    for name in WARM:
        importlib.import_module(name)
    earlier = Path(options.again).read_text(encoding="utf-8") if options.again else None
    left = total = 0
    for file in options.files:
        source = (ROOT / file).read_text(encoding="utf-8")
        for stage in STAGES:
            if (why := failure(file, ast.parse(source), stage)) is not None:
                sys.exit(f"{file}: its tests fail without a change: {why}")
        every = [
            one for one in mutants(source) if options.only in one[1] and (earlier is None or f": {one[1]}\n" in earlier)
        ][:: options.every]
        for k, (line, what, changed) in enumerate(every):
            print(f"\r{file} {k + 1}/{len(every)}, {left} survive ", end="", file=sys.stderr, flush=True)
            total += 1
            if survives(file, changed):
                left += 1
                print(f"\r{file}:{line}: {what}", flush=True)
    print(f"\n{total - left} of {total} mutants are detected, {left} survive")
    return 1 if left else 0


if __name__ == "__main__":
    sys.exit(main())
