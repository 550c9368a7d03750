"""Print where a figure of the pages is no longer what its command prints: `python -m benches.figures [PAGE ...]`.

`benches/figures.toml` has each figure's page, its words or rows there, and the command. A figure has moved where one of its
numbers is off by more than the part `within` (0.2) and by more than `least` (0), or the text of its row is another.
"""

import re
import subprocess
import sys
import tempfile
import tomllib
from itertools import zip_longest
from pathlib import Path
from typing import Any

from benches.options import described, parsed

ROOT = Path(__file__).parents[1]
TABLE: dict[str, Any] = tomllib.loads(Path(__file__).with_suffix(".toml").read_text(encoding="utf-8"))
NUMBER = re.compile(r"-?\d+(?:\.\d+)?")


def moved(then: str, now: str, within: float = 0.2, least: float = 0.0) -> list[str]:
    """Return the lines of a text that have moved."""
    lines = zip_longest(then.splitlines(), now.splitlines(), fillvalue="(no line)")
    return [f"{was}\n    is now {is_now}" for was, is_now in lines if not _alike(was, is_now, within, least)]


def _alike(was: str, is_now: str, within: float, least: float) -> bool:
    numbers = zip(map(float, NUMBER.findall(was)), map(float, NUMBER.findall(is_now)), strict=False)
    near = all(abs(a - b) <= max(least, within * abs(a)) for a, b in numbers)
    return near and NUMBER.sub("", was) == NUMBER.sub("", is_now)


def printed(row: dict[str, Any]) -> str:
    """Return what the command of a figure prints or, given `{out}` for a folder, what it makes of the page in it.

    Raises:
        CalledProcessError: the command failed. An exit code of 1 means that it did not reach its goal, which its figures show.
    """
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder, Path(row["page"]).name)
        copy.write_bytes((ROOT / row["page"]).read_bytes())
        program, *words = row["command"].format(out=folder).split()
        done = subprocess.run([Path(sys.executable).with_name(program), *words], cwd=ROOT, stdout=subprocess.PIPE, text=True)
        if done.returncode not in (0, 1):
            done.check_returncode()
        return copy.read_text(encoding="utf-8") if "{out}" in row["command"] else done.stdout


def check(row: dict[str, Any], now: str) -> list[str]:
    """Return what has moved of a figure: numbers that `prints` finds, or the rows from `begins` to `ends`."""
    if "prints" in row:
        found = re.search(row["prints"], now, re.DOTALL)
        then, now = " ".join(NUMBER.findall(row["says"])), " ".join(found.groups()) if found else "nothing of the kind"
    else:
        then, now = (_rows(row, text) for text in ((ROOT / row["page"]).read_text(encoding="utf-8"), now))
    return moved(then, now, row.get("within", 0.2), row.get("least", 0.0))


def _rows(row: dict[str, Any], text: str) -> str:
    """Return the rows of a figure in a text, the first `cells` of each."""
    inside = text.split(row["begins"], 1)[1].split(row["ends"], 1)[0]
    return "\n".join("|".join(line.split("|")[: row.get("cells", 99) + 1]) for line in inside.splitlines())


def main() -> int:
    """Print each figure's command and what of it has moved; return 0 if nothing has."""
    parser = described(__doc__)
    parser.add_argument("pages", nargs="*", metavar="PAGE", help="only figures of these pages")
    args, count = parsed(parser, "docs/pads.md"), 0
    for row in TABLE["figure"]:
        if not args.pages or row["page"] in args.pages:
            found = check(row, printed(row))
            print(
                f"{row['page']}: {row.get('says') or row['begins']}: {len(found)} moved by {row['command']}",
                *found,
                sep="\n",
                flush=True,
            )
            count += len(found)
    return int(count > 0)


if __name__ == "__main__":
    sys.exit(main())
