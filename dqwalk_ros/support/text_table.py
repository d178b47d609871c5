"""Tables of text, by rich."""

from __future__ import annotations

import io
from collections.abc import Sequence

_WIDTH = 10_000
"""Width of the console [characters]: no line is cut or wrapped, so that programs can read the output."""


def aligned(rows: Sequence[Sequence[str]], head: Sequence[str] = (), right: Sequence[int] = ()) -> str:
    """Return rows of text in columns.

    Parameters
    ----------
    head : sequence of str
        Names of the columns, with a line below them; a name may have several lines.
    right : sequence of int
        Indices of the right-aligned columns.
    """
    from rich import box
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    made = Table(box=box.SIMPLE_HEAD if head else None, show_header=bool(head), show_edge=False, pad_edge=False)
    for c in range(len(head) or len(rows[0])):
        name = Text(head[c]) if head else ""
        made.add_column(name, justify="right" if c in right else "left", no_wrap=True, header_style="")
    for row in rows:
        made.add_row(*map(Text, row))  # Text: no markup of rich
    text = io.StringIO()
    Console(file=text, width=_WIDTH, color_system=None).print(made)
    return "\n".join(line.rstrip() for line in text.getvalue().splitlines())
