"""Signals that the library handles."""

from enum import Enum


class SignalHandlerOptions(Enum):
    """None of them, or all."""

    NO = 0
    ALL = 3
