"""Quality of service, as far as a publisher names it."""

from dataclasses import dataclass
from enum import Enum


class DurabilityPolicy(Enum):
    """True if late subscribers get what was published before."""

    VOLATILE = 2
    TRANSIENT_LOCAL = 1


@dataclass(frozen=True)
class QoSProfile:
    """Publishing rules of a topic."""

    depth: int
    durability: DurabilityPolicy = DurabilityPolicy.VOLATILE
