"""`decklander campaign report DIR`: write the report of a campaign from its folder, whether it has ended or not."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from companion.tools.report.drawing import require_drawing
from estimator.contracts.errors import BadInput, unusable
from sitl.campaign.report import REPORT, render_report
from sitl.campaign.store import FLIGHTS, flights_in, manifest_of, wall_s_in, write_whole
from sitl.campaign.task import Flight


def require_report(option: str) -> None:
    """Refuse an option that draws where the drawing library is missing.

    Raises:
        BadInput: it is.
    """
    require_drawing(option)


def report(args: argparse.Namespace) -> int:
    """Write the report of the folder; return 0."""
    if args.folder is None:
        raise BadInput("campaign report needs the folder of a campaign")
    require_report("campaign report")
    folder = Path(args.folder)
    manifest = manifest_of(folder)
    path = folder / FLIGHTS
    page = render_report(manifest, flights_in(path), wall_s_in(path), compared_with(args.against))
    try:
        write_whole(folder / REPORT, page.encode())
    except OSError as why:
        raise unusable(str(folder / REPORT), why) from why
    sys.stdout.write(f"report: {folder / REPORT}\n")
    return 0


def compared_with(against: str | None) -> tuple[str, list[Flight]] | None:
    """Return the name and the flights of an earlier campaign.

    Raises:
        BadInput: the folder is that of none, or has no flights.
    """
    if against is None:
        return None
    manifest_of(Path(against))
    flights = list(flights_in(Path(against) / FLIGHTS))
    if not flights:
        raise BadInput(f"--against {against}: the campaign has no flights")
    return against, flights
