"""Message types by their names; one is missing, as in a ROS that was not installed whole."""

MISSING = "diagnostic_msgs/msg/DiagnosticArray"


def get_message(name: str) -> str:
    """Return a message's type, here its name.

    Raises:
        ModuleNotFoundError: its package is not installed.
    """
    if name == MISSING:
        raise ModuleNotFoundError("No module named 'diagnostic_msgs'")
    return name
