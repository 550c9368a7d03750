"""Make the page of the thesis' experiments again, and fail where it has moved: `python -m benches.thesis`.

A line has moved where one of its numbers is off by more than a fifth and by more than 1 in its own unit, or where its text is
another. With --smoke two seconds at 1 m, of table 5.3, are flown.
"""

import argparse
import re
import sys
from functools import partial
from itertools import zip_longest
from pathlib import Path

from benches.options import parsed
from companion.settings.load import load
from study.experiments.chapter5 import fly_chapter, with_all_methods
from study.experiments.flown import fly_by_hand
from study.experiments.hand import HeldPose, hold
from study.experiments.page import hovering, page

PAGE = Path(__file__).parents[1] / "docs/experiments.md"
NUMBER = re.compile(r"-?\d+(?:\.\d+)?")


def moved(then: str, now: str) -> list[str]:
    """Return the lines of a page that have moved."""
    lines = zip_longest(then.splitlines(), now.splitlines(), fillvalue="(no line)")
    return [f"{was}\n    is now {is_now}" for was, is_now in lines if not _alike(was, is_now)]


def _alike(was: str, is_now: str) -> bool:
    numbers = zip(map(float, NUMBER.findall(was)), map(float, NUMBER.findall(is_now)), strict=False)
    near = all(abs(a - b) <= max(1.0, 0.2 * abs(a)) for a, b in numbers)
    return near and NUMBER.sub("", was) == NUMBER.sub("", is_now)


def section(text: str, begin: str, end: str | None) -> str:
    """Return a page from one text to another, or to its end."""
    return text[text.index(begin) : text.index(end) if end else None]


def main() -> int:
    """Print the lines that have moved; return 0 if there are none."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    settings, written = load("sim"), PAGE.read_text(encoding="utf-8")
    if parsed(parser, "").smoke:
        flown = fly_by_hand(with_all_methods(settings), hold(HeldPose(0.0, 0.0, 1.0)), 2.0, 1)
        then, now = (section(text, "**Table 5.3", None) for text in (written, hovering({1.0: flown}, "z")))
        then, now = ("\n".join(re.findall(r"^\| 1 m .*", text, re.MULTILINE)[:5]) for text in (then, now))
    else:
        made = page(fly_chapter(settings, 1, partial(print, file=sys.stderr)), None, "")
        then, now = (section(text, "## 5.1.2", "## 5.2") for text in (written, made))
    found = moved(then, now)
    print(now, *found, f"{len(found)} lines have moved", sep="\n")
    return int(bool(found))


if __name__ == "__main__":
    sys.exit(main())
