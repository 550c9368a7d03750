"""The protocol side of the drone as a state machine without I/O: AT commands and the passing of time in, deeds out.

Source: Parrot AR.Drone SDK 2.0 developer guide, chapters 6 (AT commands) and 7 (navdata, state bits).

Differences between an AR.Drone 1.0 and a 2.0, beside the video, are keys, navdata options and the views of its channels. Source:
a configuration that a 1.0 with firmware 1.7.4 sent; Parrot's developer guides of SDK 1.7 and 2.0.
"""

import struct
from collections import Counter
from collections.abc import Iterator, Mapping
from enum import Enum
from functools import cache
from typing import Literal, assert_never

from msgspec import Struct, structs

from drivers.ardrone import at
from drivers.ardrone.counters import Refusal
from drivers.ardrone.navdata import ControlState, NavdataState
from estimator.contracts.errors import BadInput
from estimator.contracts.time import MonoNs, seconds_between
from estimator.vision.camera.camera import Camera
from sitl.ardrone.config import KEYS, LIMIT_KEYS, Answer, Configuration, Ids, Key, Scope
from sitl.vehicle.vehicle import VehiclePhase
from sitl.world.world import Stick

Name = Literal["1.0", "2.0"]
UVLC, P264 = "32", "64"
"""Values of video:video_codec of a 1.0."""
_LATER = (
    "general:drone_serial", "general:localtime", "control:hovering_range", "control:magneto_offset", "video:codec_fps",
    "video:max_bitrate", "video:bitrate_storage", "video:video_on_usb", "video:video_slices", "video:video_live_socket",
    "userbox:userbox_cmd", "gps:latitude", "gps:longitude", "gps:altitude",
)  # fmt: skip
"""Keys that came with the 2.0."""
_OF_THE_FIRST = {
    "general:num_version_mb": "17",
    "general:num_version_soft": "1.7.4",
    "general:soft_build_date": "2011-07-13 09:52",
    "network:ssid_single_player": "ardrone_simulated",
    "network:ssid_multi_player": "ardrone_v1.7.4",
    "pic:pic_version": "100925505",
    "video:bitrate": "6172",
    "video:bitrate_ctrl_mode": "1",
    **{f"general:motor{n}_{part}": value for n in range(1, 5) for part, value in (("soft", "1.20"), ("hard", "3.0"))},
}
_OPTIONS_OF_THE_FIRST = 21


def _keys_of_the_first() -> Iterator[Key]:
    for name, key in KEYS.items():
        if name in _LATER:
            continue
        if name == "video:video_codec":
            yield Key(name, P264, scope=Scope.SESSION, choices=frozenset({UVLC, P264}))
            yield Key("video:camif_buffers", "2", writable=False)
            yield Key("video:num_trackers", "12", writable=False)
        else:
            yield structs.replace(key, default=_OF_THE_FIRST.get(name, key.default))


class Generation(Struct, frozen=True):
    """One generation of the drone."""

    name: Name
    keys: Mapping[str, Key]
    options: int
    """Mask of the navdata options that it sends."""
    frame_rate: str
    """The key that holds the rate of the video's frames, Hz."""
    film_keys: tuple[str, ...]
    """Keys that choose its camera and its codec."""
    bottom_px: tuple[int, int] | None = None
    """Width and height of its bottom camera; None if it sends frames of any size."""

    def check_model(self, model: Name) -> None:
        """Refuse settings for the other generation.

        Raises:
            BadInput: `vehicle.model` of the settings is not this drone's.
        """
        if model != self.name:
            camera = "ardrone1_bottom" if model == "1.0" else "sim"
            raise BadInput(
                f'vehicle.model is "{model}", and the scenario flies an AR.Drone {self.name}: set vehicle.model = "{self.name}", '
                f'or the scenario\'s vehicle.generation = "{model}" with camera.file = "{camera}"'
            )

    def check_camera(self, camera: Camera) -> None:
        """Refuse a scenario's camera that this drone cannot have.

        Raises:
            BadInput: its frames are of another size.
        """
        if self.bottom_px is not None and (camera.width, camera.height) != self.bottom_px:
            raise BadInput(
                f"scenario: camera.file must describe {self.bottom_px[0]}x{self.bottom_px[1]} px, the bottom camera of an "
                f'AR.Drone {self.name}, found {camera.width}x{camera.height} px; "ardrone1_bottom" does'
            )


SECOND = Generation("2.0", KEYS, (1 << 28) - 1, "video:codec_fps", ("video:video_channel", "video:max_bitrate"))
FIRST = Generation(
    "1.0",
    {key.name: key for key in _keys_of_the_first()},
    (1 << _OPTIONS_OF_THE_FIRST) - 1,
    "video:camif_fps",
    ("video:video_channel", "video:video_codec"),
    (176, 144),
)
GENERATIONS: Mapping[Name, Generation] = {"1.0": FIRST, "2.0": SECOND}


_CHANGES_LIMITS = LIMIT_KEYS | {"control:outdoor", "custom:session_id", "custom:profile_id"}
_ALWAYS = (
    NavdataState.ALTITUDE_CONTROL | NavdataState.CAMERA_READY | NavdataState.PIC_VERSION_OK
    | NavdataState.AT_CODEC_ON | NavdataState.NAVDATA_ON | NavdataState.VIDEO_ON | NavdataState.ACQUISITION_ON
)  # fmt: skip

_REPORTED = (
    NavdataState.FLYING, NavdataState.VIDEO_ENABLED, NavdataState.VISION_ENABLED, NavdataState.COMMAND_ACK,
    NavdataState.NAVDATA_DEMO, NavdataState.NAVDATA_BOOTSTRAP, NavdataState.COMMUNICATION_LOST, NavdataState.BATTERY_LOW,
    NavdataState.USER_EMERGENCY, NavdataState.ULTRASOUND_DEAF, NavdataState.COM_WATCHDOG, NavdataState.EMERGENCY,
)  # fmt: skip
"""The bits of the state word that change, in the order in which `DroneState.word` says whether they are set."""

AIRBORNE = frozenset({VehiclePhase.TAKING_OFF, VehiclePhase.HOVERING, VehiclePhase.FLYING, VehiclePhase.LANDING})
_STEERABLE = frozenset({VehiclePhase.TAKING_OFF, VehiclePhase.HOVERING, VehiclePhase.FLYING})

LOST_COM = 8
"""Minor control state of a hovering drone that receives no commands."""

_MAJOR = {
    VehiclePhase.LANDED: ControlState.LANDED,
    VehiclePhase.TAKING_OFF: ControlState.TAKING_OFF,
    VehiclePhase.HOVERING: ControlState.HOVERING,
    VehiclePhase.FLYING: ControlState.FLYING,
    VehiclePhase.LANDING: ControlState.LANDING,
    VehiclePhase.EMERGENCY: ControlState.DEFAULT,
}
_WORDS = {phase: major.word for phase, major in _MAJOR.items()}


class RefAction(Enum):
    """An action of the drone besides following the stick."""

    TAKE_OFF = "take_off"
    LAND = "land"
    STAY_UP = "stay_up"
    """End the landing under way and hover."""
    CUT_MOTORS = "cut_motors"
    LEAVE_EMERGENCY = "leave_emergency"
    APPLY_LIMITS = "apply_limits"
    """The tilt, climb or turn limits of the configuration may have changed."""
    FLAT_TRIM = "flat_trim"
    SEND_CONFIGURATION = "send_configuration"
    SEND_CUSTOM_IDS = "send_custom_ids"


HOVER = Stick(roll=0.0, pitch=0.0, gaz=0.0, yaw=0.0, progressive=False)


class Leds(Struct, frozen=True):
    """The light show requested last."""

    animation: int
    frequency_hz: float
    duration_s: float


@cache
def _word(of: tuple[bool, ...]) -> int:
    """Return the state word with those of `_REPORTED` that are true."""
    return sum((bit.value for bit, true in zip(_REPORTED, of, strict=True) if true), int(_ALWAYS))


class DroneState:
    """Everything the drone remembers of its conversation."""

    def __init__(self, config: Configuration | None = None) -> None:
        self.config = config or Configuration()
        self.counters: Counter[str] = Counter()
        self.leds = Leds(0, 0.0, 0.0)
        self._gate = at.SequenceGate()
        self._received_at: MonoNs | None = None
        self._ids: Ids | None = None
        self._ack = False
        self._bootstrap = True
        self._watchdog = True
        self._silent = False
        self._landed_for_silence = False
        self._emergency_asked = False
        self._user_emergency = False

    @property
    def bootstrap(self) -> bool:
        """No client has chosen between demo and full navdata yet: datagrams carry the state word alone."""
        return self._bootstrap

    @property
    def silent(self) -> bool:
        """Somebody spoke to the drone once, and nobody has for general:com_watchdog seconds."""
        return self._silent

    def take(self, datagram: bytes, now: MonoNs, phase: VehiclePhase) -> Iterator[RefAction | Stick]:
        """One datagram of the AT port. What cannot be read or comes out of order is counted and has no effect."""
        for item in at.decode(datagram):
            if isinstance(item, Refusal):
                self.counters[f"at_{item.value}"] += 1
                continue
            sequence, command = item
            if not self._gate.accepts(sequence):
                self.counters["at_out_of_order"] += 1
                continue
            self.counters["at_taken"] += 1
            self._received_at = now
            self._silent = self._landed_for_silence = False
            ids, self._ids = self._ids, None
            yield from self._obey(command, ids, phase)

    def tick(self, now: MonoNs, phase: VehiclePhase) -> Iterator[RefAction | Stick]:
        """Let time pass: after general:com_watchdog seconds of silence the drone hovers, after twice that it lands.

        A drone nobody ever spoke to stays as it is.
        """
        if self._received_at is None:
            return
        patience_s = self.config.number("general:com_watchdog")
        quiet_s = seconds_between(self._received_at, now)
        if quiet_s >= patience_s and not self._silent:
            self._silent = self._watchdog = True
            self._gate.reset()
            self.counters["com_watchdog"] += 1
            if phase in _STEERABLE:
                yield HOVER
        if quiet_s >= 2 * patience_s and phase in _STEERABLE and not self._landed_for_silence:
            self._landed_for_silence = True
            self.counters["landed_for_silence"] += 1
            yield RefAction.LAND

    def word(self, phase: VehiclePhase, battery_low: bool, ultrasound_deaf: bool) -> int:
        """Navdata's state word."""
        names = ("general:video_enable", "general:vision_enable", "general:navdata_demo")
        video, vision, demo = map(self.config.flag, names)
        of = (
            phase in AIRBORNE,
            video,
            vision,
            self._ack,
            not self._bootstrap and demo,
            self._bootstrap,
            self._silent,
            battery_low,
            self._user_emergency,
            ultrasound_deaf,
            self._watchdog,
            phase is VehiclePhase.EMERGENCY,
        )
        return _word(of)

    def control_state(self, phase: VehiclePhase) -> int:
        """Return the demo option's control state: major in the upper, minor in the lower 16 bits."""
        return _WORDS[phase] | (LOST_COM if self._silent and phase is VehiclePhase.HOVERING else 0)

    def _obey(self, command: at.AtCommand, ids: Ids | None, phase: VehiclePhase) -> Iterator[RefAction | Stick]:
        match command:
            case at.Ref():
                yield from self._refer(command, phase)
            case at.Pcmd():
                if phase in _STEERABLE:
                    yield stick_of(command)
            case at.ConfigIds():
                self._ids = Ids(command.session.lower(), command.user.lower(), command.application.lower())
            case at.Config():
                yield from self._configure(command.key, command.value, ids)
            case at.Ctrl():
                yield from self._control(command.mode)
            case at.ComWdg():
                self._watchdog = False
            case at.Ftrim():
                if phase is VehiclePhase.LANDED:
                    yield RefAction.FLAT_TRIM
                else:
                    self.counters["ftrim_refused_in_flight"] += 1
            case at.Led():
                self.leds = Leds(command.animation, command.frequency_hz, float(command.duration_s))
            case at.Calib() | at.Anim():
                # The simulated vehicle has no figures to fly; that they were requested is on record.
                self.counters[f"not_flown_{command.NAME.lower()}"] += 1
            case at.Pmode() | at.Misc():
                pass
            case _:
                assert_never(command)

    def _refer(self, ref: at.Ref, phase: VehiclePhase) -> Iterator[RefAction]:
        pressed = ref.emergency and not self._emergency_asked
        self._emergency_asked = ref.emergency
        if pressed:
            leaves = phase is VehiclePhase.EMERGENCY
            self._user_emergency = not leaves
            yield RefAction.LEAVE_EMERGENCY if leaves else RefAction.CUT_MOTORS
        elif ref.take_off and phase is VehiclePhase.LANDED:
            yield RefAction.TAKE_OFF
        elif ref.take_off and phase is VehiclePhase.LANDING:
            # Assumed, not read anywhere: the wish to fly ends a landing as it begins a flight.
            yield RefAction.STAY_UP
        elif not ref.take_off and phase in _STEERABLE:
            yield RefAction.LAND

    def _configure(self, key: str, value: str, ids: Ids | None) -> Iterator[RefAction]:
        # Bit 6 says that a CONFIG was received, not that it was liked: the client reads the configuration back to know.
        if self._ack:
            self.counters["config_during_ack"] += 1
        self._ack = True
        answer = self.config.set(key, value, ids)
        self.counters[f"config_{answer.value}"] += 1
        if answer is not Answer.SET:
            return
        name = key.strip().lower()
        if name == "general:navdata_demo":
            self._bootstrap = False
        elif name == "leds:leds_anim":
            self.leds = _leds_of(value) or self.leds
        elif name == "control:flight_anim":
            self.counters["not_flown_anim"] += 1
        elif name in _CHANGES_LIMITS:
            yield RefAction.APPLY_LIMITS

    def _control(self, mode: int) -> Iterator[RefAction]:
        if mode == at.CTRL_ACK:
            self._ack = False
        elif mode == at.CTRL_CONFIGURATION:
            self._ack = True
            yield RefAction.SEND_CONFIGURATION
        elif mode == at.CTRL_CUSTOM_IDS:
            self._ack = True
            yield RefAction.SEND_CUSTOM_IDS


def stick_of(command: at.Pcmd) -> Stick:
    """Return the stick of a PCMD, each axis limited to -1..1."""
    roll, pitch, gaz, yaw = at.unit(command.roll), at.unit(command.pitch), at.unit(command.gaz), at.unit(command.yaw)
    return Stick(roll=roll, pitch=pitch, gaz=gaz, yaw=yaw, progressive=bool(command.flags & at.PCMD_PROGRESSIVE))


def _leds_of(value: str) -> Leds | None:
    """Return the LED animation of `animation,frequency bits,seconds`, or None if the value is not one."""
    words = value.split(",")
    try:
        animation, bits, seconds = (int(word) for word in words)
        (frequency,) = struct.unpack("<f", struct.pack("<I", bits & 0xFFFFFFFF))
    except ValueError:
        return None
    return Leds(animation, frequency, float(seconds))


def refusal(counters: Counter[str]) -> str | None:
    """Return the reason why the drone refused a configuration key, or None if it took every one so far."""
    refused = (answer.value for answer in Answer if answer is not Answer.SET)
    return next((why for why in refused if counters[f"config_{why}"]), None)
