"""The table of the pages' figures: its words stand on the pages, each bench of the pages is in it, and what moved is named."""

import re

from benches.figures import ROOT, TABLE, check, moved

LEFT_OUT = [(page, *row) for page, rows in TABLE["left_out"].items() for row in rows]


def test_a_line_of_a_page_that_moved_is_named() -> None:
    row = "| best | 0.1 to 5.1 m | 91 % | {} |"
    assert moved(row.format(0.6), row.format(1.4), least=1.0) == []
    assert moved(row.format(0.6), row.format(1619.3), least=1.0) == [f"{row.format(0.6)}\n    is now {row.format(1619.3)}"]
    assert len(moved(row.format(0.6), row.format("-"))) == 1
    assert len(moved(row.format(0.6), "")) == 1


def test_a_figure_in_a_sentence_is_compared_with_what_is_printed() -> None:
    row = {"says": "98 % kept it, 2.0 cm off", "prints": r"within: (\d+) %.*off by ([\d.]+) cm"}
    assert check(row, "within: 97 %\noff by 2.1 cm") == []
    assert check(row, "within: 97 %\noff by 3.1 cm") == ["98 2.0\n    is now 97 3.1"]
    assert check(row, "") == ["98 2.0\n    is now nothing of the kind"]


def test_each_figure_of_the_table_stands_on_its_page() -> None:
    words = [(row["page"], text) for row in TABLE["figure"] for key in ("says", "begins", "ends") if (text := row.get(key))]
    words += [(page, text) for page, text, _, why in LEFT_OUT if why in TABLE["reasons"]]
    assert len(words) == len(LEFT_OUT) + len(TABLE["figure"]) + 2, "each has its reason, and two are whole tables"
    assert [(page, text) for page, text in words if text not in " ".join((ROOT / page).read_text().split())] == []


def test_every_bench_that_a_page_names_is_in_the_table() -> None:
    pages = "\n".join(page.read_text() for page in (ROOT / "docs").glob("*.md") if page.name != "safety.md")
    named = set(re.findall(r"python -m (benches\.\w+)", pages))
    commands = [row["command"] for row in TABLE["figure"]] + [command for _, _, command, _ in LEFT_OUT]
    assert len(named) >= 8
    assert named <= set(re.findall(r"benches\.\w+", " ".join(commands)))
