"""The results as a table in a Markdown page: a run replaces the rows of the files that it tried."""

from collections.abc import Sequence
from pathlib import Path

from mutants.table import TARGETS
from mutants.tally import Tally

HEAD = ("| file | tried | killed | equivalent | drawn |", "|---|---|---|---|---|")
"""The head of the table."""


def write_table(page: Path, tallies: Sequence[Tally], share: float) -> None:
    """Put the rows of some files into the page's table, in the order of `mutants.table`; rows of other files stay.

    Raises:
        ValueError: the page has no such table.
    """
    lines = page.read_text().splitlines()
    if HEAD[0] not in lines:
        raise ValueError(f"{page} has no table headed {HEAD[0]!r}")
    start = lines.index(HEAD[0]) + len(HEAD)
    end = next((k for k in range(start, len(lines)) if not lines[k].startswith("|")), len(lines))
    rows = {line.split("|")[1].strip(" `"): line for line in lines[start:end]}
    rows |= {tally.path: _row(tally, share) for tally in tallies}
    table = [rows[path] for path in TARGETS if path in rows]
    page.write_text("\n".join([*lines[:start], *table, *lines[end:]]) + "\n")


def _row(tally: Tally, share: float) -> str:
    equivalent = tally.compiled_alike + tally.named
    counts = (tally.tried, tally.killed, equivalent, f"{100 * share:.0f} %")
    return f"| `{tally.path}` | {' | '.join(map(str, counts))} |"
