"""The names of the topics: `decklander/v2/<drone>/...`. A fleet shares a broker; the version changes when a meaning does."""

import re
from dataclasses import dataclass

ROOT = "decklander/v2"
_NAME = re.compile(r"[A-Za-z0-9_-]{1,64}")


@dataclass(frozen=True, slots=True)
class Topics:
    """The subtree of one drone.

    Raises:
        ValueError: a name that is not 1 to 64 letters, digits, - and _.
    """

    drone: str

    def __post_init__(self) -> None:
        if not _NAME.fullmatch(self.drone):
            raise ValueError(f"not a name of a drone: {self.drone!r}")

    def of(self, leaf: str) -> str:
        return f"{ROOT}/{self.drone}/{leaf}"

    @property
    def status(self) -> str:
        return self.of("status")

    @property
    def event(self) -> str:
        return self.of("event")

    @property
    def command(self) -> str:
        return self.of("command")

    @property
    def operator(self) -> str:
        return self.of("operator")

    @property
    def vessel(self) -> str:
        return self.of("vessel")

    @property
    def reply(self) -> str:
        return self.of("reply")

    def allows_reply(self, topic: str) -> bool:
        """Return whether `topic` is `reply` or one name below it: nobody can make us publish an answer elsewhere."""
        below = topic.removeprefix(self.reply + "/")
        return topic == self.reply or (below != topic and _NAME.fullmatch(below) is not None)


def split(topic: str) -> tuple[str, str] | None:
    """Return (drone, leaf) of a topic of ours, or None for any other."""
    parts = topic.split("/", 3)
    if len(parts) != 4 or "/".join(parts[:2]) != ROOT or not _NAME.fullmatch(parts[2]):
        return None
    return parts[2], parts[3]
