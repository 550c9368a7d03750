"""The messages of ROS 2 by the library rosbags, which is installed with the extra `ros2`."""

from importlib.util import find_spec
from typing import Any

from estimator.contracts.errors import BadInput


def require_rosbags(option: str) -> None:
    """Refuse `option` where rosbags is not installed.

    Raises:
        BadInput: it is not; the message says how to install it.
    """
    if find_spec("rosbags") is None:
        raise BadInput(
            f"{option} needs rosbags, which is not installed: install requirements/ros2.txt, or the extra decklander[ros2]"
        )


def typestore() -> Any:
    """Return the standard messages.

    Those that later grew have the fields of Jazzy. An older ROS reads them: it leaves out what comes after the end.
    """
    from rosbags.typesys import Stores, get_typestore

    return get_typestore(Stores.ROS2_JAZZY)
