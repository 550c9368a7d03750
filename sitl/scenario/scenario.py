"""The parts of a simulated flight, read from one TOML file.

    scenario = load("demo")            # a shipped one (configs/scenarios) or a path

Every key has its unit in its name, a range and a meaning; unknown keys, wrong types and values out of range are refused with
the key's path. So are faults that could never act in the scenario, or that its vessel or vehicle cannot have.

A table `[weather]` names a wind or a sea state, and takes the place of waves and wind with what belongs together: the waves that
a wind raises, its profile, its gusts, and the wake of the ship in it.
"""

import difflib
import math
import re
from collections.abc import Collection, Iterable, Iterator
from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec
from msgspec import Meta, Struct

from companion.settings.load import pad_of_file, read_camera, read_toml, shipped
from companion.settings.schema import explain
from decklander.place import SHIPPED
from estimator.contracts.errors import BadInput
from estimator.contracts.keys import choice, number, text
from estimator.contracts.motion import G_M_S2
from estimator.vision.camera.camera import Camera
from estimator.vision.pad.pad import Pad
from sitl.camera.settings import DropSettings, GimbalSettings, LampSettings, LightSettings, VideoSettings
from sitl.faults.corrupted import SIGNALS, Corrupted, Signal
from sitl.faults.fault import Fault
from sitl.faults.kinds import AnyFault, OperatorActs, OtherPad, RtkSolution, ShipSpeed, ShipTurn, VesselReports, WeakRotor
from sitl.sea.sea import EXCLUDES as SEA_EXCLUDES
from sitl.sea.sea import SEA_STATES, Sea, SeaState, WaveSystem
from sitl.sensors.rtk import RtkSettings
from sitl.sensors.settings import SensorSettings
from sitl.vehicle.airframe import VehicleFile, VehicleSettings, rotors
from sitl.vehicle.airframe import load as load_vehicle
from sitl.vehicle.disturbances import EffectSettings, WrongModel
from sitl.vessel.air import EXCLUDES as WIND_EXCLUDES
from sitl.vessel.air import WindSettings
from sitl.vessel.file import DEFAULT_HULL, RecordedMotion, Ship, VesselSettings
from sitl.vessel.file import EXCLUDES as VESSEL_EXCLUDES
from sitl.vessel.file import load as load_vessel
from sitl.vessel.seakeeping import HULLS

_PM_HEIGHT = 2.0 * math.sqrt(0.0081 / 0.74)
"""Significant height of a fully grown sea by U^2 / g, U being the wind at 19.5 m (Pierson & Moskowitz 1964)."""
_FETCH_HEIGHT, _FETCH_PEAK = 4.0 * math.sqrt(1.6e-7), 3.5
"""JONSWAP's laws of growth (Hasselmann et al. 1973): height by U^2 / g is the first times the root of x = g F / U^2, and the
peak's frequency, Hz, by g / U is the second times x^(-1/3)."""
_CHARNOCK, _KARMAN = 0.0144, 0.4
"""Charnock's constant of the open sea (DNV-RP-C205 gives 0.011 to 0.014; 0.0144 after Garratt 1977)."""
_LEAST_ROUGHNESS_M = 1e-5
_SWELL_HEIGHT, _SWELL_PERIOD, _SWELL_ASIDE_DEG = 0.5, 1.6, 60.0
"""The swell of open water by the height and period of the wind's own sea. With it spectra are about as wide and as little peaked
as buoys measure them (docs/evidence.md); how far it crosses is assumed."""


class WeatherSettings(Struct, frozen=True, forbid_unknown_fields=True):
    """The wind, and the sea that it raises."""

    wind_m_s: Annotated[float, number("mean wind 10 m over the water", "m/s", 0.5, 20.0)] | None = None
    sea_state: (
        Annotated[int, number("WMO code 3700 of a sea that the wind raised, or of an older one beside wind_m_s", "1", 1, 6)]
        | None
    ) = None
    fetch_km: (
        Annotated[float, number("length of water over which the wind blows; a fully grown sea by default", "km", 0.1, 2e4)] | None
    ) = None
    from_deg: (
        Annotated[float, number("direction from which wind and waves come; the wind's by default", "deg", -360.0, 360.0)] | None
    ) = None
    gusts: Annotated[
        Literal["kaimal", "dryden"],
        choice("turbulence: Kaimal's over the sea's roughness, or MIL-F-8785C's, which is about twice as strong"),
    ] = "kaimal"
    wake: Annotated[bool, choice("whether hull and superstructure slow and stir the air")] = True

    @property
    def given(self) -> bool:
        """True if it sets anything."""
        return self.wind_m_s is not None or self.sea_state is not None

    def sea(self, beside: Sea, from_deg: float) -> Sea:
        """Return the waves that the wind raises, and on open water a swell that crosses them.

        Args:
            beside: a sea whose current stays.
            from_deg: direction of the wind where these settings say none.
        """
        state, to_deg = self._state(), (self._from_deg(from_deg) + 180.0) % 360.0
        height_m, period_s = _SWELL_HEIGHT * state.hs_m, _SWELL_PERIOD * state.tp_s
        return Sea(
            significant_height_m=state.hs_m,
            peak_period_s=state.tp_s,
            peak_enhancement=state.gamma,
            runs_to_deg=to_deg,
            swell=WaveSystem(height_m, period_s, runs_to_deg=to_deg + _SWELL_ASIDE_DEG) if self.fetch_km is None else None,
            current_m_s=beside.current_m_s,
            current_to_deg=beside.current_to_deg,
        )

    def wind(self, beside: WindSettings, *, superstructure: bool) -> WindSettings:
        """Return the wind over this sea.

        Args:
            beside: a wind whose direction and single gusts stay where these settings say none.
            superstructure: whether the ship has one.
        """
        return WindSettings(
            speed_m_s=self._speed_m_s(),
            from_deg=self._from_deg(beside.from_deg),
            model=self.gusts,
            profile="logarithmic",
            roughness_m=roughness_m(self._speed_m_s()),
            wake=self.wake and superstructure,
            hull_wake=self.wake,
            gusts=beside.gusts,
        )

    def _from_deg(self, otherwise: float) -> float:
        return otherwise if self.from_deg is None else self.from_deg

    def _state(self) -> SeaState:
        if self.wind_m_s is not None and self.sea_state is not None:
            return SeaState.fully_grown(SEA_STATES[self.sea_state].hs_m)
        return raised_sea(self._speed_m_s(), self.fetch_km)

    def _speed_m_s(self) -> float:
        if self.wind_m_s is not None:
            return self.wind_m_s
        return raising_wind_m_s(SEA_STATES[self.sea_state or 1].hs_m, self.fetch_km)


def roughness_m(wind_m_s: float) -> float:
    """Return the roughness of the sea's surface under a wind at 10 m, by Charnock's relation z0 = a u*^2 / g."""
    z = 2e-4
    for _ in range(20):
        z = max(_LEAST_ROUGHNESS_M, _CHARNOCK * (_KARMAN * wind_m_s / math.log(10.0 / z)) ** 2 / G_M_S2)
    return z


def raised_sea(wind_m_s: float, fetch_km: float | None = None) -> SeaState:
    """Return the sea that a steady wind at 10 m raises over a fetch; the fully grown one where no fetch limits it."""
    grown = SeaState.fully_grown(_PM_HEIGHT * (wind_m_s * _by_height(wind_m_s)) ** 2 / G_M_S2)
    if fetch_km is None:
        return grown
    x = 1e3 * fetch_km * G_M_S2 / wind_m_s**2
    height_m = _FETCH_HEIGHT * math.sqrt(x) * wind_m_s**2 / G_M_S2
    if height_m >= grown.hs_m:
        return grown
    return SeaState(height_m, wind_m_s / (G_M_S2 * _FETCH_PEAK * x ** (-1.0 / 3.0)), 3.3)


def raising_wind_m_s(height_m: float, fetch_km: float | None = None) -> float:
    """Return the steady wind at 10 m that raises a significant height over a fetch, by bisection."""
    low, high = 0.1, 60.0
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if raised_sea(middle, fetch_km).hs_m < height_m else (low, middle)
    return high


def _by_height(wind_m_s: float) -> float:
    """Return the wind at 19.5 m over that at 10 m, by the logarithmic profile."""
    z = roughness_m(wind_m_s)
    return math.log(19.5 / z) / math.log(10.0 / z)


_KEPT = {"sea": ("current_m_s", "current_to_deg"), "wind": ("from_deg", "gusts")}
"""Keys of waves and wind that a table `weather` leaves as they are."""


def refuse_idle(keys: Iterable[str], scenario: "Scenario", where: str) -> None:
    """Refuse keys, given in a file or by an option, of waves, wind and weather that do not act in this scenario.

    Raises:
        BadInput: one of them follows from the weather, or is of a weather that is not there.
    """
    for table, name in (key.split(".")[:2] for key in keys if "." in key):
        if scenario.weather.given and table in _KEPT and name not in _KEPT[table]:
            instead = "weather.sea_state or weather.wind_m_s" if table == "sea" else "weather.wind_m_s, gusts or wake"
            kept = f"beside it {table} may say {', '.join(_KEPT[table])} alone"
            raise BadInput(f"{where}: {table}.{name} follows from the weather: set {instead}; {kept}")
        if table == "weather" and not scenario.weather.given:
            raise BadInput(f"{where}: weather.{name} acts beside weather.wind_m_s or weather.sea_state alone")


def signals_of(vessel: VesselSettings, vehicle: VehicleSettings) -> tuple[Signal, ...]:
    """Return the signals of a flight whose detections are drawn."""
    there: dict[Signal, bool] = {
        "gnss": vehicle.gnss_hz > 0.0,
        "ship_velocity": vessel.reports_hz > 0.0,
        "ship_heading": vessel.reports_hz > 0.0 or vessel.turn_hz > 0.0,
        "ship_place": vessel.reports_hz > 0.0 and vessel.reports_place,
        "ship_heave": vessel.motion_hz > 0.0,
        "ship_tilt": vessel.motion_hz > 0.0,
        "ship_turn": vessel.turn_hz > 0.0,
        "ship_wind": vessel.wind_hz > 0.0,
    }
    return tuple(signal for signal in SIGNALS if there.get(signal, True))


def _contradictions(fault: Fault, scenario: "Scenario") -> Iterator[str]:
    """Return why a fault could never act in a scenario, or its vessel cannot have it, in words that follow its path."""
    limit_s, start, vessel, below = scenario.duration_limit_s, scenario.start, scenario.vessel, fault.below_height_m
    if fault.at_s is not None and fault.at_s >= limit_s:
        yield f".at_s is {fault.at_s:g} s, but the flight ends after {limit_s:g} s"
    if below is not None and start.where == "air" and start.height_m < below:
        yield f".below_height_m is {below:g} m, but the flight starts at {start.height_m:g} m"
    if isinstance(fault, VesselReports) and vessel.reports_hz == 0.0:
        yield ": vessel_reports is of a ship that reports, and this one does not; vessel.reports_hz must be more than 0"
    if isinstance(fault, VesselReports) and (fault.place_north_m or fault.place_east_m) and not vessel.reports_place:
        yield ": this ship does not report her place; vessel.reports_place must be true"
    if isinstance(fault, Corrupted) and fault.signal not in signals_of(vessel, scenario.vehicle):
        needs = {"gnss": "vehicle.gnss_hz", "ship_turn": "vessel.turn_hz", "ship_wind": "vessel.wind_hz"}
        needs |= dict.fromkeys(("ship_heave", "ship_tilt"), "vessel.motion_hz")
        need = f"{needs.get(fault.signal, 'vessel.reports_hz')} must be more than 0"
        need = "vessel.reports_place must be true" if fault.signal == "ship_place" else need
        yield f".signal is {fault.signal}, which is not there; {need}"
    if isinstance(fault, RtkSolution) and scenario.rtk.rate_hz == 0.0:
        yield ": rtk_solution is of receivers that are not there; rtk.rate_hz must be more than 0"
    if isinstance(fault, ShipSpeed | ShipTurn) and vessel.moored:
        yield f": {fault.kind} is of a vessel under way; vessel.moored must be false"
    if isinstance(fault, ShipSpeed | ShipTurn) and vessel.turn_rate_deg_s != 0.0:
        yield f": {fault.kind} does not go with a vessel that turns already; vessel.turn_rate_deg_s must be 0"
    if isinstance(fault, ShipTurn) and vessel.speed_m_s == 0.0:
        yield ": a vessel that lies still does not turn; vessel.speed_m_s must be more than 0"
    if isinstance(fault, ShipSpeed) and fault.to_m_s == vessel.speed_m_s:
        yield f".to_m_s is {fault.to_m_s:g} m/s, which is vessel.speed_m_s already"


_EXCLUDES: dict[str, dict[str, tuple[str, ...]]] = {
    "sea": SEA_EXCLUDES,
    "vessel": VESSEL_EXCLUDES,
    "weather": {"wind_m_s": ("sea_state",), "sea_state": ("wind_m_s",)},
    "wind": WIND_EXCLUDES,
}
FAULTS = "faults"
"""Folder of the shipped scenarios that have one fault each."""
TITLE_MAX = 120
"""Number of characters of a title."""


class Start(Struct, frozen=True, forbid_unknown_fields=True):
    """The start of the vehicle, relative to the pad at that instant."""

    where: Annotated[
        Literal["air", "pad"], choice("start of the vehicle: hovering in the air, or on the pad's centre with its motors off")
    ] = "air"
    height_m: Annotated[float, number("height of the body's origin over the pad's centre, in the air", "m", 0.3, 60.0)] = 5.0
    pad_forward_m: Annotated[float, number("distance of the pad ahead of the vehicle, in the air", "m", -100.0, 100.0)] = 0.0
    pad_right_m: Annotated[float, number("distance of the pad to the right of the vehicle, in the air", "m", -100.0, 100.0)] = 0.0
    heading_deg: Annotated[float, number("heading of the vehicle from the arrow, clockwise from above", "deg", -360.0, 360.0)] = (
        0.0
    )
    with_vessel: Annotated[
        bool, Meta(description="whether the vehicle starts with the vessel's steady velocity instead of at rest over the ground")
    ] = True


class CameraView(Struct, frozen=True, forbid_unknown_fields=True):
    """The bottom camera."""

    file: Annotated[str, text("a shipped camera (configs/cameras), or a path relative to the scenario file", 200)] = "sim"
    exposure_s: Annotated[float, number("exposure time", "s", 0.0, 0.1, "assumed")] = 0.008
    blur_sigma_px: Annotated[
        float, number("standard deviation of the Gaussian blur of lens and colour filter", "px", 0.0, 10.0, "assumed")
    ] = 0.6
    full_well_e: Annotated[
        float, number("electrons at full scale, which determine the shot noise", "1", 100.0, 1e6, "assumed")
    ] = 8000.0
    read_noise_e: Annotated[float, number("standard deviation of the read noise, electrons", "1", 0.0, 1000.0, "assumed")] = 12.0
    readout_s: Annotated[
        float, number("time from the first row's exposure to the last one's; 0 for a global shutter", "s", 0.0, 0.1)
    ] = 0.0
    exposure_lag_s: Annotated[
        float, number("time constant of the automatic exposure, which meters the whole picture; 0 for none", "s", 0.0, 30.0)
    ] = 0.0
    exposure_longest_s: Annotated[
        float, number("longest exposure of the automatic; with less light it amplifies", "s", 0.001, 0.1, "assumed")
    ] = 0.02
    white_balance_lag_s: Annotated[
        float,
        number("time constant of the automatic white balance, which takes the picture for grey; 0 for none", "s", 0.0, 60.0),
    ] = 0.0


class PadView(Struct, frozen=True, forbid_unknown_fields=True):
    """The pad on deck."""

    file: Annotated[str, text("a shipped pad (configs/pads), or a path relative to the scenario file", 200)] = "thesis"


class Scenario(Struct, frozen=True, forbid_unknown_fields=True):
    """One flight to simulate."""

    title: Annotated[str, text("one line for people", TITLE_MAX)]
    duration_limit_s: Annotated[float, number("longest time of the flight", "s", 1.0, 36000.0)] = 120.0
    sea: Sea = Sea()
    vessel: VesselSettings = VesselSettings()
    wind: WindSettings = WindSettings()
    weather: WeatherSettings = WeatherSettings()
    start: Start = Start()
    camera: CameraView = CameraView()
    gimbal: GimbalSettings = GimbalSettings()
    pad: PadView = PadView()
    light: LightSettings = LightSettings()
    lamps: LampSettings = LampSettings()
    drops: DropSettings = DropSettings()
    video: VideoSettings = VideoSettings()
    sensors: SensorSettings = SensorSettings()
    rtk: RtkSettings = RtkSettings()
    vehicle: VehicleSettings = VehicleSettings()
    effects: EffectSettings = EffectSettings()
    wrong_model: WrongModel = WrongModel()
    faults: Annotated[tuple[AnyFault, ...], Meta(max_length=100, description="in any order")] = ()
    expect: Annotated[
        Literal["land", "refuse", "go_around", "hold", "either"],
        choice(
            "the right outcome: it lands on the pad, it refuses to (hovers or climbs and reports it), it goes around and lands; "
            "it holds for the operator, or it either lands or refuses"
        ),
    ] = "land"
    unreached_contacts: Annotated[
        bool,
        choice(
            "whether it may touch pad or deck while nothing reaches it, and in the landing that it then begins by itself: "
            "for faults in which no order could prevent it"
        ),
    ] = False
    refusal: Annotated[str, text("words that the reason of a refusal must hold; empty for any reason", 100, shortest=0)] = ""
    because: Annotated[str, text("one line that says why that is right", 300, shortest=0)] = ""

    def __post_init__(self) -> None:
        for n, fault in enumerate(self.faults):
            for why in _contradictions(fault, self):
                raise ValueError(f"faults[{n}]{why}")
        if self.refusal and self.expect not in ("refuse", "either"):
            raise ValueError(
                f"refusal is the reason of a refusal, and expect is {self.expect!r}: give refusal only with refuse or either"
            )
        if self.expect == "hold" and not any(isinstance(fault, OperatorActs) for fault in self.faults):
            raise ValueError("expect is 'hold', but nobody takes over: give a fault of kind operator")


def load(name_or_path: str | Path, base: str | None = None) -> Scenario:
    """Return the scenario in a file, or a shipped one (`configs/scenarios/*.toml`, `faults/*.toml` there) by its bare name.

    A file may name a `base`. It then has only what differs, and its faults are added to those of the base. Camera and pad files
    are read too; in the result `camera.file` and `pad.file` are relative to the working directory.

    Args:
        base: a scenario that takes the place of the base that the file names; so the same fault is flown in another sea.

    Raises:
        BadInput: a file cannot be read as TOML; a key is unknown, missing, of the wrong type or out of range; a base refers
            to itself; or a camera or pad file has such a fault. The text is one line that names the file and the key.
    """
    path = _find(str(name_or_path), "scenarios", Path(), "scenario")
    if base is not None:
        base = str(_find(base, "scenarios", Path(), "base"))
    scenario = from_mapping(_with_base(path, (), base), str(path))
    camera_model(scenario)
    pad_model(scenario)
    ship_model(scenario)
    vehicle_model(scenario)
    return scenario


def _with_base(path: Path, above: tuple[Path, ...], instead: str | None = None) -> dict[str, Any]:
    """Return the merged content of a file and its bases; each is checked alone, so that an error names its own file."""
    if path.resolve() in above:
        raise BadInput(f"{path}: base leads back to this file")
    data = read_toml(path, "title")
    name = data.pop("base", None)
    beside = path.parent
    if instead is not None:
        name, beside = instead, Path()
    base: dict[str, Any] = {}
    if name is not None:
        if not isinstance(name, str):
            raise BadInput(f"{path}: base must be the name of a scenario or a path, found {name!r}")
        base = _with_base(_find(name, "scenarios", beside, f"{path}: base"), (*above, path.resolve()))
    whole = _merged(base, data)
    try:
        scenario = msgspec.convert(whole, Scenario, strict=True)
    except msgspec.ValidationError as why:
        raise BadInput(f"{path}: {_explain(whole, str(why), len(base.get('faults', ())))}") from why
    refuse_idle([f"{table}.{key}" for table, keys in data.items() if isinstance(keys, dict) for key in keys], scenario, str(path))
    for table, folder, named in (("camera", "cameras", scenario.camera.file), ("pad", "pads", scenario.pad.file)):
        if table not in base or table in data:
            found = _find(named, folder, path.parent, f"{path}: {table}.file")
            whole[table] = {**whole.get(table, {}), "file": str(found)}
    for table, folder in (("vessel", "vessels"), ("vehicle", "vehicles")):
        output: Any = data.get(table, {})
        if "file" in output:
            whole[table]["file"] = str(_find(output["file"], folder, path.parent, f"{path}: {table}.file"))
        if output.get("motion"):
            whole[table]["motion"] = str(path.parent / output["motion"])
    return whole


def replaced(table: str, given: Collection[str]) -> set[str]:
    """Return the keys of a table that given ones replace, as `sea.sea_state` replaces a height."""
    return {name for key in given for name in _EXCLUDES.get(table, {}).get(key, ())}.difference(given)


def _merged(base: dict[str, Any], over: dict[str, Any]) -> dict[str, Any]:
    """Return the tables of both, merged key by key; the faults of the base come first."""
    out = dict(base)
    for key, value in over.items():
        under = out.get(key)
        if isinstance(under, dict) and isinstance(value, dict):
            gone = replaced(key, value)
            out[key] = {**{name: kept for name, kept in under.items() if name not in gone}, **value}
        elif key == "faults" and isinstance(under, list) and isinstance(value, list):
            out[key] = [*under, *value]
        else:
            out[key] = value
    return out


def shipped_scenarios() -> list[str]:
    """Return the names of the shipped scenarios; those with a fault are `faults/NAME`."""
    return [*shipped("scenarios"), *(f"{FAULTS}/{name}" for name in shipped(f"scenarios/{FAULTS}"))]


def from_mapping(data: dict[str, Any], where: str) -> Scenario:
    """Return the scenario that the mapping of a TOML file describes; `where` names the file in errors.

    Raises:
        BadInput: as for `load`, except that camera and pad files are not read.
    """
    try:
        return msgspec.convert(data, Scenario, strict=True)
    except msgspec.ValidationError as why:
        raise BadInput(f"{where}: {_explain(data, str(why))}") from why


def camera_model(scenario: Scenario) -> Camera:
    """Return the camera that `scenario.camera.file` names.

    Raises:
        BadInput: the file is missing or has a fault.
    """
    return read_camera(_find(scenario.camera.file, "cameras", Path(), "camera.file"))


def with_ardrone1(scenario: Scenario) -> Scenario:
    """Return the scenario flown by an AR.Drone 1.0, with its bottom camera."""
    vehicle = msgspec.structs.replace(scenario.vehicle, generation="1.0")
    camera = msgspec.structs.replace(scenario.camera, file="ardrone1_bottom")
    return msgspec.structs.replace(scenario, vehicle=vehicle, camera=camera)


def refuse_gimbal(scenario: Scenario) -> None:
    """Refuse a scenario that an AR.Drone cannot fly.

    Raises:
        BadInput: the scenario's camera hangs on a gimbal.
    """
    if scenario.gimbal.given:
        raise BadInput("gimbal: an AR.Drone has none; fly it with simulate --autopilot arducopter")


def pad_model(scenario: Scenario) -> Pad:
    """Return the pad that `scenario.pad.file` names.

    Raises:
        BadInput: the file is missing or has a fault.
    """
    for n, fault in enumerate(scenario.faults):
        if isinstance(fault, OtherPad):
            pad_of_file(_find(fault.file, "pads", Path(), f"faults[{n}].file"))
    return pad_of_file(_find(scenario.pad.file, "pads", Path(), "pad.file"))


def vehicle_model(scenario: Scenario) -> VehicleFile:
    """Return the vehicle that `scenario.vehicle.file` names.

    Raises:
        BadInput: the file is missing or has a fault, or a fault of the scenario is of a rotor that the vehicle does not have or
            begins lower than it ever is.
    """
    path = _find(scenario.vehicle.file, "vehicles", Path(), "vehicle.file")
    vehicle = load_vehicle(path)
    frame = vehicle.airframe()
    names = [rotor.name for rotor in rotors(frame)]
    for n, fault in enumerate(scenario.faults):
        if fault.below_height_m is not None and fault.below_height_m <= frame.feet.below_m:
            stands = f"{path} stands {frame.feet.below_m:g} m over the deck and is never lower"
            raise BadInput(f"faults[{n}].below_height_m is {fault.below_height_m:g} m, but {stands}")
        if isinstance(fault, WeakRotor) and fault.rotor not in names:
            raise BadInput(f"faults[{n}].rotor must be one of {', '.join(names)} of {path}, found {fault.rotor!r}")
    return vehicle


def ship_model(scenario: Scenario) -> Ship:
    """Return the vessel that `scenario.vessel` names.

    Raises:
        BadInput: its file is missing, has a fault, or contradicts the scenario: a recording that is too short or moored, a
            turn of a ship that is recorded or whose metacentric height is not known.
    """
    v = scenario.vessel
    if v.file is None:
        ship, where = Ship(HULLS[v.hull or DEFAULT_HULL]), f"hull {v.hull or DEFAULT_HULL}"
    else:
        path = _find(v.file, "vessels", Path(), "vessel.file")
        ship, where = load_vessel(path), str(path)
    if v.motion:
        ship, where = Ship(ship.hull, RecordedMotion.of_file(Path(v.motion), v.motion_smooth_s), random_start=True), v.motion
    return _fitting(ship, scenario, where)


def _fitting(ship: Ship, scenario: Scenario, where: str) -> Ship:
    v, recorded = scenario.vessel, ship.recorded
    if scenario.wind.wake and not scenario.weather.given and ship.hull.superstructure is None:
        raise BadInput(f"{where}: wind.wake needs a vessel with a superstructure in its file")
    if recorded is not None:
        if v.moored:
            raise BadInput(f"{where}: a recording holds the vessel's whole motion; vessel.moored must be false")
        if v.turn_rate_deg_s != 0.0:
            raise BadInput(f"{where}: a recorded vessel does not turn; vessel.turn_rate_deg_s must be 0")
        if recorded.lasts_s < scenario.duration_limit_s:
            raise BadInput(
                f"{where}: the recording lasts {recorded.lasts_s:.1f} s and the flight up to {scenario.duration_limit_s:g} s; "
                "shorten duration_limit_s, or repeat it with recording.loop_blend_s"
            )
    turns = v.turn_rate_deg_s != 0.0 or any(isinstance(fault, ShipTurn) for fault in scenario.faults)
    if turns and (ship.hull.gm_m is None or ship.hull.kg_m is None):
        raise BadInput(f"{where}: a turn needs gm_m and kg_m of the vessel, for its heel")
    return ship


def sea_of(scenario: Scenario) -> Sea:
    """Return the waves of a scenario: those that its weather raises, or those of its table `sea`."""
    if not scenario.weather.given:
        return scenario.sea
    return scenario.weather.sea(scenario.sea, scenario.wind.from_deg)


def wind_of(scenario: Scenario) -> WindSettings:
    """Return the wind of a scenario: that of its weather, or that of its table `wind`."""
    if not scenario.weather.given:
        return scenario.wind
    return scenario.weather.wind(scenario.wind, superstructure=ship_model(scenario).hull.superstructure is not None)


class _One(Struct, frozen=True):
    fault: AnyFault


def _explain(data: dict[str, Any], said: str, inherited: int = 0) -> str:
    """Return one line; a fault in the list is compared with its own kind, and numbered as in its own file."""
    if found := re.search(r"\$\.faults\[(\d+)\]", said):
        n = int(found[1])
        line = explain(_One, {"fault": data["faults"][n]}, said.replace(f".faults[{n}]", ".fault"))
        return re.sub(r"\bfault(?=[.: ]|$)", f"faults[{n - inherited}]", line)
    return explain(Scenario, data, said)


_SHOWN = 12
"""Number of shipped files that a refusal names."""


def _find(name: str, folder: str, base: Path, what: str) -> Path:
    known = shipped_scenarios() if folder == "scenarios" else shipped(folder)
    if name in known:
        return SHIPPED / folder / f"{name}.toml"
    try:
        path = base / name
        if name and path.is_dir():
            raise BadInput(f"{what}: {str(path)!r} is a folder, and not a file")
        if name and path.exists():
            return path
    except (OSError, ValueError) as why:
        raise BadInput(f"{what}: not a usable file name {name[:60]!r}") from why
    near = difflib.get_close_matches(name, known, n=1)
    shown = sorted(known, key=lambda one: ("/" in one, one))[:_SHOWN]
    more = f" and {len(known) - _SHOWN} more in configs/{folder}" if len(known) > _SHOWN else ""
    hint = f"did you mean {near[0]!r}?" if near else f"shipped ones are {', '.join(shown)}{more}"
    raise BadInput(f"{what}: there is no file {str(path) if name else name!r} and no shipped one of that name ({hint})")
