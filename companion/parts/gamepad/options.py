"""The settings of the gamepad: keys of the table [operator]."""

from typing import Annotated

from companion.settings.operator import OperatorOptions
from estimator.contracts.keys import text


class GamepadOperator(OperatorOptions, frozen=True, forbid_unknown_fields=True):
    """The commands of people on this computer: the terminal (`decklander fly`) and the gamepad."""

    gamepad: Annotated[
        str,
        text(
            'mapping of the gamepad: the name of a shipped file, or a path from the working directory; "off" for no gamepad',
            4096,
            public=True,
        ),
    ] = "off"
    gamepad_device: Annotated[
        str, text('a part of the gamepad\'s name, or its path; "any" for the first one that is found', 256, public=True)
    ] = "any"
