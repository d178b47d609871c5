"""The tests named in tables of faults and defects exist."""

from __future__ import annotations

import ast
import re
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent


def test_tests_in_the_table_of_faults_exist() -> None:
    rows = [r for r in (ROOT / "docs" / "faults.md").read_text(encoding="utf-8").splitlines() if r.startswith("| ")][1:]
    assert len(rows) > 15
    for line in rows:
        shown = re.findall(r"`([^`]*)`", line.split("|")[3])
        assert shown, line
        file = ""
        for name in shown:
            path, _, test = name.partition("::")
            file = path or file
            text = (ROOT / "test" / file).read_text(encoding="utf-8")
            assert not test or f"def {test}(" in text, name


def test_tests_in_the_list_of_interoperability_defects_exist() -> None:
    own = "test_interoperability"
    table = ast.get_docstring(ast.parse((ROOT / "test" / f"{own}.py").read_text(encoding="utf-8"))) or ""
    defects = re.split(r"^ ?\d+\. ", table, flags=re.M)[1:]
    assert len(defects) == 18
    for defect in defects:
        named = re.findall(r"^ +(?:(\w+)::)?(test_\w+)$", defect, re.M)
        assert named, defect
        for file, test in named:
            assert f"def {test}(" in (ROOT / "test" / f"{file or own}.py").read_text(encoding="utf-8"), test
