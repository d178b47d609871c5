"""The tests named in the table of faults exist."""

from __future__ import annotations

import re
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]


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
