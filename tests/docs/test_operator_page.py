"""The page for operators shows the table of precedence that the service uses."""

from pathlib import Path

from companion.cli.fly import KEYS, MOTIONS, ORDERS
from companion.guidance.operator.precedence import markdown

PAGE = (Path(__file__).parents[2] / "docs/operator.md").read_text()


def test_the_page_holds_the_table_of_precedence() -> None:
    shown = PAGE.partition("<!-- precedence -->\n")[2].partition("<!-- /precedence -->")[0]
    assert shown == markdown(), "copy what python -m companion.guidance.operator.precedence prints"


def test_the_page_names_every_order_and_key() -> None:
    assert all(f"decklander fly {name}" in PAGE for name in ORDERS)
    letters = [key for key in (*MOTIONS, *KEYS) if len(key) == 1 and key != " "]
    assert all(f"`{key}`" in PAGE for key in letters)
