"""Rank the pages in the documentation's search: a hook of mkdocs."""

from typing import Any

BOOSTS = {"How-to guides": 2.0, "Tutorial": 1.5, "Reference": 1.5, "Explanation": 0.5, "Evidence": 0.3}
"""The weight of each section of the navigation; guides come first, for readers search for tasks and symptoms."""
_OTHERS = 0.2
"""The weight of pages that are in no section: decision records and the home page."""


def on_page_markdown(markdown: str, page: Any, config: Any, **_: Any) -> str:
    """Set the weight and the search words of a page, which the search plugin reads as metadata; return the text unchanged."""
    sections = [section.title for section in page.ancestors]
    page.meta.setdefault("search", {"boost": BOOSTS.get(sections[-1], 1.0) if sections else _OTHERS})
    page.meta.setdefault("tags", config.extra["search_words"].get(page.file.src_uri, "").split())
    return markdown
