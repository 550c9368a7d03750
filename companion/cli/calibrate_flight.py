"""`decklander calibrate mount`, `delay` and `readout`: the camera on the vehicle, from a recorded minute's flight."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Mapping, MutableMapping
from pathlib import Path
from typing import Any

import tomlkit
from tomlkit.exceptions import TOMLKitError

from companion.cli.options import check_new, option, print_result, recording_argument
from companion.recording.channels import CAMERA
from companion.recording.reading import Recording, open_recording
from companion.settings.load import load
from companion.settings.model import in_file
from companion.tools.calibrate.flight_result import MountResult, flight_result, readout_result
from companion.tools.calibrate.flight_views import FlightViews, flight_views
from companion.tools.calibrate.touchdown_cost import TouchdownCost
from drivers.ardrone.options import ArDroneOptions
from estimator.contracts.errors import BadInput, file_errors, refused


def with_values(text: str, table: str, values: Mapping[str, Any], where: str) -> str:
    """Return the text with values set in a table; a key or table that is not there is added at the end of its place.

    Args:
        table: dotted name of the table; "" for the keys before the first table.
        where: names the file in errors.

    Raises:
        BadInput: the text is no TOML, or the table's name is that of a value.
    """
    with refused(where, TOMLKitError):
        document = tomlkit.parse(text)
    place: MutableMapping[str, Any] = document
    for name in table.split(".") if table else ():
        place = place.setdefault(name, tomlkit.table())
        if not isinstance(place, MutableMapping):
            raise BadInput(f"{where}: {table} is not a table")
    place.update(values)
    return tomlkit.dumps(document)


_HOW = (
    "Fly by hand for a minute at 2 to 4 m over a pad ashore, the pad in view: lean left, right, forward and back, turn by 90 "
    "degrees or more both ways, and record it. Exit code 1, and no file, if the flight does not tell."
)
_GYRO_TRAILS_S = 0.005
"""A gyro may trail its stamps by as much, so that a delay seems to be less than none."""
FILTER_DELAY_LEAST_S = 0.002
"""The filter does not get a smaller sigma of the delay than this: it drifts by as much."""


def add_parsers(actions: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add `mount`, `delay` and `readout` to the actions of `calibrate`."""
    mount = actions.add_parser(
        "mount",
        help="measure how the camera is turned on the vehicle, from a recorded flight",
        description=f"Measure how the camera is turned on the vehicle. {_HOW}",
    )
    option(mount, "--out FILE", "write the recorded camera file with the new mount; a new file", type=Path)
    delay = actions.add_parser(
        "delay",
        help="measure the delay of the camera's frames, from a recorded flight",
        description=f"Measure how late frames are against the gyro. {_HOW}",
    )
    option(delay, "--config FILE", "settings file to change; with --out")
    option(delay, "--out FILE", "write the settings file with the new delay; a new file", type=Path)
    readout = actions.add_parser(
        "readout",
        help="measure the readout time of a rolling shutter, from a recorded flight",
        description=f"Measure how long the camera takes from its first row to its last. {_HOW} It needs the images.",
    )
    option(readout, "--out FILE", "write the recorded camera file with readout_s; a new file", type=Path)
    for parser in (mount, delay, readout):
        recording_argument(parser)
        option(parser, "--json", "print one JSON object")


def run(args: argparse.Namespace) -> int:
    """Run the command and return its exit code."""
    check_new(args.out)
    recording = open_recording(args.recording)
    actions = {"mount": _mount, "delay": _delay, "readout": _readout}
    return actions[args.action](args, recording)


def _mount(args: argparse.Namespace, recording: Recording) -> int:
    result = _result(args, recording)
    why = result.mount_refusal()
    if why is None and args.out is not None:
        text = recording.attachments[CAMERA].decode("utf-8")
        values = {
            "rpy_body_cam_deg": [round(float(a), 3) for a in result.rpy_deg],
            "mount_cov_deg2": [[round(float(c), 6) for c in row] for row in result.cov_mount_deg2],
        }
        noted = f"# Mount calibrated from {recording.name}: rpy_body_cam_deg was {_three(result.rpy_was_deg)}.\n"
        _write(args.out, noted + with_values(text, "", values, f"{recording.name}: {CAMERA}"))
    turned, sigma = result.turned_deg, result.mount_sigma_deg
    level, level_sigma = result.level_deg
    lines = [
        f"turned {' '.join(f'{axis} {t:+.2f} +- {s:.2f}' for axis, t, s in zip(_AXES, turned, sigma, strict=True))} degrees from "
        "its file",
        f"mount  rpy_body_cam_deg {_three(result.rpy_deg)}, was {_three(result.rpy_was_deg)}",
        _cost_line(*result.mount_costs()),
        f"level  the reported attitude is off by roll {level[0]:+.2f} +- {level_sigma[0]:.2f}, pitch {level[1]:+.2f} +- "
        f"{level_sigma[1]:.2f} degrees: trim the vehicle, not the camera",
    ]
    record = {
        "rpy_body_cam_deg": result.rpy_deg.tolist(), "was_deg": result.rpy_was_deg.tolist(), "turned_deg": turned.tolist(),
        "sigma_deg": sigma.tolist(), "cov_deg2": result.cov_mount_deg2.tolist(), "level_deg": level.tolist(),
        "level_sigma_deg": level_sigma.tolist(), **_cost_record(*result.mount_costs()),
    }  # fmt: skip
    return _say(args, result, why, lines, record)


def _delay(args: argparse.Namespace, recording: Recording) -> int:
    if (args.out is None) != (args.config is None):
        raise BadInput("--out and --config go together: the delay stands in the settings file")
    settings = recording.settings()
    if settings is None:
        raise BadInput(f"{recording.name}: does not hold its settings")
    of_vehicle = isinstance(settings.vehicle, ArDroneOptions)
    key = "vehicle.video_delay_s" if of_vehicle else "camera.latency_s"
    was = settings.vehicle.video_delay_s if isinstance(settings.vehicle, ArDroneOptions) else settings.camera.latency_s
    result = _result(args, recording)
    found, why = was - result.later_s, result.delay_refusal()
    if -_GYRO_TRAILS_S < found < 0.0:
        found = 0.0
    if why is None and found < 0.0:
        why = f"{in_file(key)} would be {1e3 * found:.1f} ms: the frames' stamps lie before the exposure; check their source"
    if why is None and args.out is not None:
        _write_delay(args, key, was, found, result.delay_sigma_s)
    lines = [
        f"delay  {in_file(key)} {1e3 * found:.1f} +- {1e3 * result.delay_sigma_s:.1f} ms, was {1e3 * was:.1f}",
        _cost_line(*result.delay_costs()),
    ]
    record = {"key": in_file(key), "delay_s": found, "was_s": was, "sigma_s": result.delay_sigma_s}
    return _say(args, result, why, lines, record | _cost_record(*result.delay_costs()))


def _write_delay(args: argparse.Namespace, key: str, was: float, found: float, sigma_s: float) -> None:
    now = load(args.config)
    v = now.vehicle
    stands = v.video_delay_s if isinstance(v, ArDroneOptions) else now.camera.latency_s
    if abs(stands - was) > 1e-6:
        flown = f"{was:g} in the recording; name the settings flown with"
        raise BadInput(f"--config {args.config}: {in_file(key)} is {stands:g}, but {flown}")
    try:
        text = Path(args.config).read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as why:
        raise BadInput(f"--config {args.config}: give the path of a settings file: {why}") from why
    known = {
        key: round(found, 5),
        f"{key.removesuffix('_s')}_sigma_s": round(max(sigma_s, 1e-4), 5),
        "estimator.ekf.sigma_delay_s": round(max(FILTER_DELAY_LEAST_S, sigma_s), 5),
    }
    for path, value in known.items():
        table, _, name = in_file(path).rpartition(".")
        text = with_values(text, table, {name: value}, str(args.config))
    _write(args.out, text)


def _readout(args: argparse.Namespace, recording: Recording) -> int:
    result = readout_result(recording, _views(args, recording))
    found, sigma_s, was_s, why = result.readout_s, result.sigma_s, result.was_s, result.refusal()
    if why is None and args.out is not None:
        text = recording.attachments[CAMERA].decode("utf-8")
        noted = f"# Readout calibrated from {recording.name}: {found:.5f} +- {sigma_s:.5f} s, was {was_s:g}.\n"
        _write(args.out, noted + with_values(text, "", {"readout_s": round(found, 5)}, f"{recording.name}: {CAMERA}"))
    lines = [
        f"readout  readout_s {1e3 * found:.1f} +- {1e3 * sigma_s:.1f} ms, was {1e3 * was_s:.1f}"
        + ("; that is a global shutter, or nearly one" if abs(found) < 3.0 * sigma_s else ""),
        _cost_line(*result.costs()),
    ]
    record = {"readout_s": found, "was_s": was_s, "sigma_s": sigma_s}
    return _say(args, result.mount, why, lines, record | _cost_record(*result.costs()))


def _result(args: argparse.Namespace, recording: Recording) -> MountResult:
    return flight_result(_views(args, recording))


def _views(args: argparse.Namespace, recording: Recording) -> FlightViews:
    views = flight_views(recording)
    if not args.json and sys.stderr.isatty():
        sys.stderr.write(f"{views.t.size} views of the pad; fitting ...\n")
    return views


_AXES = ("about forward", "right", "down")


def _say(args: argparse.Namespace, result: MountResult, why: str | None, lines: list[str], record: Mapping[str, Any]) -> int:
    fit, advice = result.fit, result.advice()
    whole = {
        "good": why is None, "refused": why, "missing": advice, "file": str(args.out) if args.out and why is None else None,
        "views": fit.views, "left_out": fit.left_out, **record,
    }  # fmt: skip
    lines.append(f"flight {result.coverage.in_words()}; {fit.views} views, {fit.left_out} left out")
    if why is not None:
        lines.append(f"not known well enough: {why}" + ("; it lacks:" if advice else ""))
    elif args.out is not None:
        lines.append(f"written to {args.out}" + ("; it would be better with:" if advice else ""))
    elif advice:
        lines.append("it would be better with:")
    lines += [f"  - {lack}" for lack in advice]
    print_result(args, whole, "\n".join(lines))
    return 0 if why is None else 1


def _cost_line(was: TouchdownCost, now: TouchdownCost) -> str:
    return (
        f"cost   {was.touchdown_cm:.1f} cm at touchdown ({was.approach_cm:.1f} cm at 3 m) as it was, {now.touchdown_cm:.2f} cm "
        f"({now.approach_cm:.1f} cm) for one sigma of what is left"
    )


def _cost_record(was: TouchdownCost, now: TouchdownCost) -> dict[str, object]:
    return {"cost_was_cm": was.touchdown_cm, "cost_sigma_cm": now.touchdown_cm}


def _three(values: Any) -> str:
    return "[" + ", ".join(f"{float(v):.2f}" for v in values) + "]"


def _write(path: Path, content: str) -> None:
    with file_errors(f"--out {path}"), path.open("x", encoding="utf-8") as file:
        file.write(content)
