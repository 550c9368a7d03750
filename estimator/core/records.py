"""Structures of the native core that are still read by index: the words of records."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from estimator.contracts.geometry import F64
from estimator.core.library import CORE


def record(name: str, values: Mapping[str, Any]) -> F64:
    """Return the words of a structure; members as `Door.record` takes them."""
    return CORE.record(name, **values).reshape(1).view(np.float64)
