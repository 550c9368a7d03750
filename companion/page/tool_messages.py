"""The messages of the page's tools: what a browser asks of them, and what they answer. No I/O."""

from __future__ import annotations

from msgspec import Struct


class ExamineRequest(Struct, frozen=True, kw_only=True, tag_field="kind", tag="examine", forbid_unknown_fields=True):
    """Examine the setup as `decklander doctor` does. It is answered by an `ExaminedReport`, at once and at the end."""


class PageFinding(Struct, frozen=True, kw_only=True):
    """One fault of the setup."""

    rule: str
    severity: str
    """error, warning or advice."""
    what: str
    fix: str


class ExaminedReport(Struct, frozen=True, kw_only=True, tag_field="kind", tag="examined"):
    """The findings of an examination, the most severe first; or that it is under way, or why there is none."""

    text: str
    busy: bool = False
    """Whether the examination is still under way."""
    findings: tuple[PageFinding, ...] | None = None
    """None if nothing was examined."""


ToolRequest = ExamineRequest
ToolAnswer = ExaminedReport
