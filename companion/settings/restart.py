"""Options of restarts, in a module of their own so that settings are read without loading the supervisor."""

from typing import Annotated

from msgspec import Struct

from estimator.contracts.keys import check_ranges, number


class RestartOptions(Struct, frozen=True, forbid_unknown_fields=True):
    """The restart of failed parts, and the point at which they are given up.

    Raises:
        ValueError: a number outside its range, or back-offs that do not go together.
    """

    restart_first_s: Annotated[float, number("first back-off before a failed part restarts", "s", 0.01, 60.0)] = 0.2
    restart_factor: Annotated[float, number("factor between a back-off and the next", "1", 1.0, 10.0)] = 2.0
    restart_cap_s: Annotated[float, number("longest rest", "s", 0.01, 600.0)] = 5.0
    restart_healthy_after_s: Annotated[
        float, number("time of uninterrupted work after which a part begins with the first back-off again", "s", 0.1, 3600.0)
    ] = 5.0
    restart_give_up_after: Annotated[
        int,
        number(
            "failures in a row after which a part beside the flight is given up; those of the outside world do not count",
            "1",
            1,
            1000,
        ),
    ] = 10

    def __post_init__(self) -> None:
        check_ranges(self)
        if self.restart_cap_s < self.restart_first_s:
            raise ValueError(
                f"restart_cap_s ({self.restart_cap_s:g} s) must not be shorter than restart_first_s ({self.restart_first_s:g} s)"
            )
