"""`decklander calibrate` by a recorded flight: the camera's `mount`, `delay` and `readout`, and how the `vehicle` answered."""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Mapping, MutableMapping
from operator import attrgetter
from pathlib import Path
from typing import Any

import numpy as np
import tomlkit
from tomlkit.exceptions import TOMLKitError

from companion.cli.options import named_wait, option, print_result, reading, recording_argument, require_drawing, tell_damage
from companion.cli.outputs import CAMERA_FILE, PLOT, RESPONSE_FILE, SETTINGS, output
from companion.guidance.law.margins import LoopMargins, margins
from companion.guidance.law.response_fit import ClimbFit, TiltFit, fit_climb, fit_tilt, text
from companion.recording.channels import CAMERA
from companion.recording.reading import Recording, open_recording
from companion.settings.guidance import FollowDeckOptions, Response, TiltResponse
from companion.settings.load import load, read_text, response_model, shipped, shipped_response, write_whole
from companion.settings.model import Settings, in_file
from companion.tools.calibrate import flight_result as results
from companion.tools.calibrate.flight_views import FlownCourses, flight_views, flown_courses
from companion.tools.calibrate.touchdown_cost import ResponseCost, TouchdownCost, tilt_of_file, tilt_of_sigma
from estimator.contracts.errors import BadInput, file_errors, refused

_HELP = "identify a vehicle's response from a recorded flight"
_DESCRIPTION = (
    "Identify how a vehicle answers commands from a recorded flight: delay, frequency and damping of its tilt, "
    "delay and lag of its climb. Print their covariance, and the error at touchdown that their errors cause, in centimetres. "
    "Record a landing by the controller follow_deck, which commands tilt: a flight by hand does not suffice. Exit code 1 if the "
    "flight moved too little."
)
NOTHING_TOLD_S = 0.1
"""A delay that is known worse than this is not known at all."""
_CURE = 'record a landing with guidance.controller = "follow_deck"'
_CHI2_95 = 7.81
"""Chi-square of three values that 95 % lie below."""
DELAY_MARGIN_S = 0.06
"""Least delay beyond the known one that the law should stand."""
_GYRO_TRAILS_S = 0.005
"""A gyro may trail its stamps by as much, so that a delay seems to be less than none."""
FILTER_DELAY_LEAST_S = 0.002
"""The filter does not get a smaller sigma of the delay than this: it drifts by as much."""


def _add_vehicle(actions: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    parser = actions.add_parser("vehicle", help=_HELP, description=_DESCRIPTION)
    recording_argument(parser)
    option(parser, "--response NAME", "shipped response or file to begin from (default: the one of the recorded settings)")
    output(parser, "--out FILE", "write the response file (TOML)", RESPONSE_FILE)
    output(parser, "--plot FILE", "draw commanded, reported and modelled courses into this file (png, svg, pdf)", PLOT)
    option(parser, "--json", "print one JSON object")


def _vehicle(args: argparse.Namespace, recording: Recording) -> int:
    if args.plot is not None:
        require_drawing("--plot")
    start = _start(args.response, recording)
    courses = flown_courses(recording)
    tell_damage(recording.cut, "identified")
    with named_wait("fitting", quiet=args.json):
        tilt, climb = _fits(recording, courses, start)
    if tilt.delay_sigma_s > NOTHING_TOLD_S:
        sys.stderr.write(
            f"decklander: {recording.name}: too little motion to identify a response: the delay of the tilt is known to "
            f"{1e3 * tilt.delay_sigma_s:.0f} ms only, from {tilt.fitted.seconds:.1f} s of commanded flight; fly in wind "
            "or over a moving deck, or longer\n"
        )
        return 1
    response = Response(tilt.response, start.climb if climb is None else climb.response)
    if args.out is not None:
        _write(args.out, text(response, recording.name, tilt, climb))
    if args.plot is not None:
        from companion.tools.calibrate.figures import write_response

        assert courses.tilt is not None
        write_response(args.plot, recording.name, courses, tilt, climb)
    loops = {"by_the_given": margins(start.tilt, tilt.response), "by_the_identified": margins(tilt.response)}
    costs = tilt_of_file(start.tilt, tilt.response), tilt_of_sigma(tilt.response, tilt.cov)
    record = _record(tilt, climb) | {"loop": {name: _loop_record(loop) for name, loop in loops.items()}}
    record |= {"cost_was_cm": _finite(costs[0].cost_cm), "cost_sigma_cm": _finite(costs[1].cost_cm)}
    record |= {"chi2_of_given": _apart(start.tilt, tilt), "cut": {str(p): why for p, why in recording.cut.items()}}
    print_result(args, record, "\n".join(_lines(args, start, courses, tilt, climb, loops, costs)))
    return 0


def _start(named: str | None, recording: Recording) -> Response:
    if named is None:
        try:
            settings = recording.settings()
            if settings is None:
                raise BadInput(f"{recording.name}: holds no settings")
            return response_model(settings)
        except BadInput as why:
            names = ", ".join(shipped("responses"))
            raise BadInput(
                f"{why}; name the response that it flew by with --response, a file or a shipped one ({names})"
            ) from why
    return shipped_response(named, "--response")


def _fits(recording: Recording, courses: FlownCourses, start: Response) -> tuple[TiltFit, ClimbFit | None]:
    if courses.leans == 0:
        why = (
            f"its {courses.velocities} commands ask for velocities, as the controller pid and a flight by hand do, and none for "
            f"a tilt; {_CURE}"
            if courses.velocities
            else f"it holds no commands of guidance; {_CURE}"
        )
        raise BadInput(f"{recording.name}: no response can be identified: {why}")
    tilt = None if courses.tilt is None else fit_tilt(courses.tilt, start.tilt)
    if tilt is None:
        by_hand = f"; {courses.velocities} others are velocities, as by hand" if courses.velocities else ""
        raise BadInput(
            f"{recording.name}: no response can be identified: {courses.leans} commands for a tilt and the vehicle's attitude "
            f"overlap by less than 4 s{by_hand}; {_CURE}"
        )
    return tilt, None if courses.climb is None else fit_climb(courses.climb, start.climb)


def _lines(
    args: argparse.Namespace,
    start: Response,
    courses: FlownCourses,
    tilt: TiltFit,
    climb: ClimbFit | None,
    loops: dict[str, LoopMargins],
    costs: tuple[ResponseCost, ResponseCost],
) -> list[str]:
    t = tilt.response
    out = [
        f"tilt   delay {_ms(t.delay_s, t.delay_sigma_s)} ms, {_of(t.frequency_rad_s, t.frequency_sigma_rad_s)} rad/s, damping "
        f"{_of(t.damping, t.damping_sigma)}; lag {1e3 * t.lag_s:.0f} ms as given",
        f"       {tilt.gain:.2f} of the command, {tilt.fitted.residual:.3f} m/s^2 off the model, {tilt.fitted.seconds:.1f} s",
    ]
    if climb is None:
        out.append("climb  not identified: as given")
    else:
        c = climb.response
        by = "the accelerometer" if courses.by_accelerometer else "the reported speed"
        out += [
            f"climb  delay {_ms(c.delay_s, c.delay_sigma_s)} ms, lag {_ms(c.lag_s, c.lag_sigma_s)} ms",
            f"       {climb.gain:.2f} of the command, {climb.fitted.residual:.3f} m/s off the model, by {by}",
        ]
    out.append(
        f"given  tilt delay {_ms(start.tilt.delay_s, start.tilt.delay_sigma_s)} ms, "
        f"{_of(start.tilt.frequency_rad_s, start.tilt.frequency_sigma_rad_s)} rad/s, damping "
        f"{_of(start.tilt.damping, start.tilt.damping_sigma)}; climb delay {_ms(start.climb.delay_s, start.climb.delay_sigma_s)} "
        f"ms, lag {_ms(start.climb.lag_s, start.climb.lag_sigma_s)} ms"
    )
    apart = _apart(start.tilt, tilt)
    verb = "contradicts" if apart > _CHI2_95 else "does not contradict"
    out.append(f"       this flight {verb} the given tilt: chi-square {apart:.1f}; 95 % of such flights lie below {_CHI2_95:.1f}")
    out += [f"loop   {name.replace('_', ' ')} response: {_margins(loop)}" for name, loop in loops.items()]
    out.append(_cost_of_response(*costs))
    out.append(_service_line(t.delay_sigma_s or 0.0))
    out += [f"written to {path}" for path in (args.out, args.plot) if path is not None]
    return out


def _cost_of_response(was: ResponseCost, now: ResponseCost) -> str:
    before = f"{was.cost_cm:.1f} cm at touchdown by the given response ({was.error_cm:.2f} cm rms instead of {was.own_cm:.2f})"
    if not math.isfinite(was.error_cm):
        before = "the loop by the given response is unstable"
    after = f"{now.cost_cm:.1f} cm ({now.error_cm:.2f} instead of {now.own_cm:.2f}) for one sigma of the identified one"
    if not math.isfinite(now.error_cm):
        after = "by the identified one it is unstable one sigma away: fly longer, or in wind"
    return f"cost   tilt: {before}, {after}"


def _service_line(delay_sigma_s: float) -> str:
    known_ms, sigma_ms = 1e3 * FollowDeckOptions().delay_known_s, 1e3 * delay_sigma_s
    if sigma_ms <= known_ms:
        return f"use    with this file the service flies with full gains from the start: the delay is known to {known_ms:.0f} ms"
    return (
        f"use    with this file the service begins with softer gains, until the delay is known to {known_ms:.0f} ms instead of "
        f"{sigma_ms:.0f}; fly longer, or in wind"
    )


def _apart(given: TiltResponse, found: TiltFit) -> float:
    """Return the chi-square of the difference between the given response and the identified one."""
    t, cov = found.response, found.cov
    if given.cov_delay_frequency_damping is not None:
        cov = cov + np.array(given.cov_delay_frequency_damping)
    else:
        sigmas = given.delay_sigma_s, given.frequency_sigma_rad_s, given.damping_sigma
        cov = cov + np.diag([(sigma or 0.0) ** 2 for sigma in sigmas])
    off = np.array([t.delay_s - given.delay_s, t.frequency_rad_s - given.frequency_rad_s, t.damping - given.damping])
    return float(off @ np.linalg.solve(cov, off))


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None


def _margins(loop: LoopMargins) -> str:
    if not loop.stable:
        return "UNSTABLE"
    down, up = loop.gain
    short = f", less than {1e3 * DELAY_MARGIN_S:.0f}" if loop.delay_s < DELAY_MARGIN_S else ""
    return (
        f"gain {down:.2f} to {up:.1f} times, phase {loop.phase_deg:.0f} degrees, "
        f"{1e3 * loop.delay_s:.0f} ms of further delay{short}; {1e2 * loop.error_m:.1f} cm a side at sea state 4"
    )


def _loop_record(loop: LoopMargins) -> dict[str, object]:
    return {
        "stable": loop.stable, "gain_down": loop.gain[0], "gain_up": _finite(loop.gain[1]), "phase_deg": loop.phase_deg,
        "delay_s": _finite(loop.delay_s), "sensitivity": loop.sensitivity, "error_m": _finite(loop.error_m),
    }  # fmt: skip


def _of(value: float, sigma: float | None) -> str:
    return f"{value:.2f}" if sigma is None else f"{value:.2f} +- {sigma:.2f}"


def _ms(value_s: float, sigma_s: float | None) -> str:
    return f"{1e3 * value_s:.0f}" if sigma_s is None else f"{1e3 * value_s:.0f} +- {1e3 * sigma_s:.0f}"


def _record(tilt: TiltFit, climb: ClimbFit | None) -> dict[str, object]:
    t = tilt.response
    record: dict[str, object] = {
        "tilt": {
            "delay_s": t.delay_s, "delay_sigma_s": t.delay_sigma_s,
            "frequency_rad_s": t.frequency_rad_s, "frequency_sigma_rad_s": t.frequency_sigma_rad_s,
            "damping": t.damping, "damping_sigma": t.damping_sigma, "lag_s": t.lag_s,
            "cov_delay_frequency_damping": tilt.cov.tolist(),
            "gain": tilt.gain, "residual_m_s2": tilt.fitted.residual, "seconds": tilt.fitted.seconds,
        },
        "climb": None,
    }  # fmt: skip
    if climb is not None:
        c = climb.response
        record["climb"] = {
            "delay_s": c.delay_s, "delay_sigma_s": c.delay_sigma_s, "lag_s": c.lag_s, "lag_sigma_s": c.lag_sigma_s,
            "cov_delay_lag": climb.cov.tolist(),
            "gain": climb.gain, "residual_m_s": climb.fitted.residual, "seconds": climb.fitted.seconds,
        }  # fmt: skip
    return record


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


def add_parsers(actions: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add what reads a recorded flight to the actions of `calibrate`."""
    mount = actions.add_parser(
        "mount",
        help="measure how the camera is turned on the vehicle, from a recorded flight",
        description=f"Measure how the camera is turned on the vehicle. {_HOW}",
    )
    output(mount, "--out FILE", "write the recorded camera file with the new mount", CAMERA_FILE)
    delay = actions.add_parser(
        "delay",
        help="measure the delay of the camera's frames, from a recorded flight",
        description=f"Measure how late frames are against the gyro. {_HOW}",
    )
    option(delay, "--config FILE", "settings file to change; with --out")
    output(delay, "--out FILE", "write the settings file with the new delay", SETTINGS)
    readout = actions.add_parser(
        "readout",
        help="measure the readout time of a rolling shutter, from a recorded flight",
        description=f"Measure how long the camera takes from its first row to its last. {_HOW} It needs the images.",
    )
    output(readout, "--out FILE", "write the recorded camera file with readout_s", CAMERA_FILE)
    for parser in (mount, delay, readout):
        recording_argument(parser)
        option(parser, "--json", "print one JSON object")
    _add_vehicle(actions)


def run(args: argparse.Namespace) -> int:
    """Run the command and return its exit code."""
    recording = open_recording(args.recording)
    recording.watch = reading(recording.name, quiet=args.json)
    actions = {"mount": _mount, "delay": _delay, "readout": _readout, "vehicle": _vehicle}
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
    key = _delay_key(settings)
    was = attrgetter(key)(settings)
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


def _delay_key(settings: Settings) -> str:
    """Return the key of the delay from the exposure to the frames that the estimator gets."""
    return f"vehicle.{settings.vehicle.frames_delay}" if settings.camera.source == "vehicle" else "camera.latency_s"


def _write_delay(args: argparse.Namespace, key: str, was: float, found: float, sigma_s: float) -> None:
    now = load(args.config)
    stands = attrgetter(_delay_key(now))(now)
    if abs(stands - was) > 1e-6:
        flown = f"{was:g} in the recording; name the settings flown with"
        raise BadInput(f"--config {args.config}: {in_file(key)} is {stands:g}, but {flown}")
    with refused(f"--config {args.config}: give the path of a settings file", BadInput):
        text = read_text(Path(args.config))
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
    views = flight_views(recording)
    with named_wait("searching the images for the time of a row", quiet=args.json):
        result = results.readout_result(recording, views)
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


def _result(args: argparse.Namespace, recording: Recording) -> results.MountResult:
    views = flight_views(recording)
    with named_wait(f"fitting {views.t.size} views of the pad", quiet=args.json):
        return results.flight_result(views)


_AXES = ("about forward", "right", "down")


def _say(args: argparse.Namespace, of: results.MountResult, why: str | None, lines: list[str], record: Mapping[str, Any]) -> int:
    fit, advice = of.fit, of.advice()
    whole = {
        "good": why is None, "refused": why, "missing": advice, "file": str(args.out) if args.out and why is None else None,
        "views": fit.views, "left_out": fit.left_out, **record,
    }  # fmt: skip
    lines.append(f"flight {of.coverage.in_words()}; {fit.views} views, {fit.left_out} left out")
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
    with file_errors(f"--out {path}"):
        write_whole(path, content)
