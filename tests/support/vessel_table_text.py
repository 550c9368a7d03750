"""The text of a vessel's response table, for files that benches and tests write."""

from sitl.vessel.file import Mode, Table
from sitl.vessel.seakeeping import MODES


def as_toml(table: Table) -> str:
    """Return the text of a table as a vessel's file holds it."""
    lines = ["[table]", f"encounter_rad_s = {_row(table.encounter_rad_s)}", f"heading_deg = {_row(table.heading_deg)}"]
    for mode in MODES:
        held: Mode | None = getattr(table, mode)
        if held is not None:
            lines += ["", f"[table.{mode}]"]
            for name, rows in (("amplitude", held.amplitude), ("phase_deg", held.phase_deg)):
                lines += [f"{name} = [", *(f"  {_row(row)}," for row in rows), "]"]
    return "\n".join(lines) + "\n"


def _row(values: tuple[float, ...]) -> str:
    return "[" + ", ".join(f"{value:.6g}" for value in values) + "]"
