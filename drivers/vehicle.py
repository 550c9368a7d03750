"""The port of a kind of vehicle: the facts that its table `[vehicle]` gives to all that names no kind.

A kind of vehicle is a class of options with its own `kind`, which says here what is true of it, and a function that makes its
part of the service (`companion.settings.capabilities`).
"""

import math
from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any, ClassVar

from msgspec import Struct

from estimator.contracts.keys import CheckedOptions

PHASE_MODES = ("", "flying", "hovering")
"""Modes of a vehicle that reports its phase of flight as its mode, or nothing: they do not say whether it flies by velocities."""


class Claim(Struct, frozen=True):
    """A thing that one service of this computer has for itself."""

    key: str
    what: str
    """The thing in words."""
    fix: str
    """The way by which two services get by beside each other."""
    rivals: tuple[str, ...] = ()
    """Keys of others that cannot be held beside this one."""


class Barred(Struct, frozen=True):
    """A setting of another table that a kind of vehicle does not go with."""

    key: str
    """Its dotted path."""
    is_wrong: Callable[[Any], bool]
    why: str
    """The rest of a sentence that begins with the key."""


class AnsweringVehicle(Struct, frozen=True):
    """A vehicle whose address and camera are known, which `decklander start` looks for and writes settings of."""

    word: str
    """Its name at the command line."""
    summary: str
    """One line about it, for a person who chooses."""
    kind: str
    """The word of `vehicle.kind`."""
    host: str
    camera_file: str
    answers: Callable[[str], bool]
    """True for a host at which it answers."""
    missing: Callable[[str], str]
    """Returns the step that comes first where it does not answer at a host."""
    settings: tuple[str, ...] = ()
    """The further lines of its table [vehicle]."""
    searched: bool = False
    """True if it is looked for where nobody names a vehicle."""
    simulated: bool = False


class VehicleOptions(CheckedOptions, frozen=True, forbid_unknown_fields=True):
    """The facts of any kind of vehicle."""

    frames_delay: ClassVar[str] = ""
    """Its key that holds the delay of the vehicle's own frames, s; empty if the vehicle has no camera of its own."""
    over_ground: ClassVar[bool] = False
    """True if its own hover holds over the ground, and its driver adds the deck's velocity to one that is commanded."""
    returns: ClassVar[bool] = False
    """True if it can fly away from the ship by itself."""
    takes_targets: ClassVar[bool] = False
    """True if it takes LANDING_TARGETs, by which it may land itself."""
    has_default_feet: ClassVar[bool] = False
    """True if the feet of the settings' defaults are its own."""
    orders_recordings: ClassVar[bool] = False
    """True if a recording may be switched over its link."""
    response: ClassVar[str]
    """The shipped response of the kind."""
    defaults: ClassVar[Mapping[tuple[str, str], Mapping[str, object]]] = MappingProxyType({})
    """Defaults of other tables that depend on the kind, by table; they hold where a settings file names no value."""
    barred: ClassVar[tuple[Barred, ...]] = ()
    """Settings that it does not go with."""
    ship_keys: ClassVar[tuple[str, ...]] = ()
    """Its keys that name a source of the ship's place if they are set."""

    @property
    def kind(self) -> str:
        """The word of `vehicle.kind`."""
        return str(self.__struct_config__.tag)

    @property
    def name(self) -> str:
        """The vehicle's name for a person."""
        raise NotImplementedError

    @property
    def in_words(self) -> str:
        """The vehicle and its links, in one line for a person."""
        raise NotImplementedError

    @property
    def address(self) -> str:
        """A word that distinguishes it from other vehicles of this computer."""
        raise NotImplementedError

    @property
    def left_alone(self) -> str:
        """Its way on in the air once the service has ended, in words."""
        raise NotImplementedError

    @property
    def decoder_for(self) -> str:
        """The setting by which its own frames need PyAV; empty if they do not."""
        return ""

    @property
    def probe(self) -> tuple[str, int] | None:
        """Host and TCP port that answer while it is there; None if it has none."""
        return None

    @property
    def tilt_max_deg(self) -> float:
        """The largest tilt that its driver lets through, degrees."""
        return math.inf

    @property
    def climb_max_m_s(self) -> float:
        """The largest climb and descent rate that its driver lets through, m/s."""
        return math.inf

    @property
    def mode_is_order(self) -> bool:
        """True if a mode that a person chooses is an order to go on."""
        return False

    @property
    def generation(self) -> str:
        """The generation of its protocol, where there are several that the simulator has; else empty."""
        return ""

    def simulated(self, generation: str, tilt_max_deg: float) -> "VehicleOptions":
        """Return the options with what a simulated vehicle of its kind is: links, generation, the tilt that its loops reach."""
        return self

    def modes_left(self, mode: str) -> tuple[str, ...]:
        """Return the modes of a vehicle that nobody has taken since it was in a mode; none where modes do not say."""
        return ()

    def claims(self) -> list[Claim]:
        """Return what a service has for itself by having this vehicle."""
        return []


def host_and_port(host: str, port: int) -> str:
    """Return an address of the network as a key: one spelling for each."""
    return f"{'127.0.0.1' if host == 'localhost' else host.lower()}:{port}"
