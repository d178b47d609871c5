"""The tests named in the tables of faults exist."""

from __future__ import annotations

import re
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]


def test_tests_in_the_tables_of_faults_exist() -> None:
    """Each cell after fault and effect names at least one, of each plant where the table has a column for each."""
    lines = (ROOT / "docs" / "faults.md").read_text(encoding="utf-8").splitlines()
    rows = [[part.strip() for part in line.split("|")[1:-1]] for line in lines if line.startswith("| ")]
    heads = [row for row in rows if row[0] == "fault"]
    assert heads[0] == ["fault", "what happens", "physics", "drive", "poppy"]
    assert all(head == ["fault", "what happens", "shown by"] for head in heads[1:])
    assert len(rows) > 40
    for row in (row for row in rows if row not in heads):
        assert len(row) in (3, 5), row
        for cell in row[2:]:
            shown = re.findall(r"`([^`]*)`", cell)
            assert shown, row
            file = ""
            for name in shown:
                path, _, test = name.partition("::")
                file = path or file
                text = (ROOT / "test" / file).read_text(encoding="utf-8")
                assert not test or f"def {test}(" in text, name
