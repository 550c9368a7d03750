"""`decklander calibrate vehicle`: how a vehicle answered its commands, from a recorded flight."""

import argparse
import math
import sys
from pathlib import Path

import numpy as np

from companion.cli.options import check_new, option, print_result, recording_argument, require_drawing
from companion.guidance.law.margins import LoopMargins, margins
from companion.guidance.law.response_fit import ClimbFit, TiltFit, fit_climb, fit_tilt, text
from companion.recording.reading import Recording, open_recording
from companion.settings.guidance import FollowDeckOptions, Response, TiltResponse, response_from_mapping
from companion.settings.load import find_file, read_toml, response_model, shipped
from companion.tools.calibrate import touchdown_cost
from companion.tools.calibrate.flown_courses import FlownCourses, flown_courses
from companion.tools.calibrate.touchdown_cost import ResponseCost
from estimator.contracts.errors import BadInput, file_errors

HELP = "identify a vehicle's response from a recorded flight"
DESCRIPTION = (
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


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    recording_argument(parser)
    option(parser, "--response NAME", "shipped response or file to begin from (default: the one of the recorded settings)")
    option(parser, "--out FILE", "write the response file (TOML)", type=Path)
    option(parser, "--plot FILE", "draw commanded, reported and modelled courses into this PNG", type=Path)
    option(parser, "--json", "print one JSON object")


def run(args: argparse.Namespace) -> int:
    """Run the command and return its exit code."""
    if args.plot is not None:
        require_drawing("--plot")
    check_new(args.out)
    recording = open_recording(args.recording)
    start = _start(args.response, recording)
    courses = flown_courses(recording)
    for path, why in recording.cut.items():
        sys.stderr.write(f"decklander: {path} is cut short ({why}): identified from what comes before\n")
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
    costs = touchdown_cost.tilt_of_file(start.tilt, tilt.response), touchdown_cost.tilt_of_sigma(tilt.response, tilt.cov)
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
    path = find_file(named, "responses", Path(), "--response")
    return response_from_mapping(read_toml(path), str(path))


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
        by_hand = f", beside {courses.velocities} for velocities, as by hand" if courses.velocities else ""
        raise BadInput(
            f"{recording.name}: no response can be identified: {courses.leans} commands for a tilt and the vehicle's attitude "
            f"overlap by less than 4 s{by_hand}; {_CURE}"
        )
    return tilt, None if courses.climb is None else fit_climb(courses.climb, start.climb)


def _write(path: Path, content: str) -> None:
    with file_errors(f"--out {path}"):
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(content, encoding="utf-8")


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
            f"       {climb.gain:.2f} of the command, {climb.fitted.residual:.3f} m/s beside the model, by {by}",
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
    out.append(_cost_line(*costs))
    out.append(_service_line(t.delay_sigma_s or 0.0))
    out += [f"written to {path}" for path in (args.out, args.plot) if path is not None]
    return out


def _cost_line(was: ResponseCost, now: ResponseCost) -> str:
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
        return f"use    a service with this file begins with its full gains: the delay is known to {known_ms:.0f} ms"
    return (
        f"use    a service with this file begins with softer gains, until the delay is known to {known_ms:.0f} ms instead of "
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
    finite = math.isfinite(loop.error_m)
    return {
        "stable": loop.stable, "gain_down": loop.gain[0], "gain_up": loop.gain[1] if math.isfinite(loop.gain[1]) else None,
        "phase_deg": loop.phase_deg, "delay_s": loop.delay_s if math.isfinite(loop.delay_s) else None,
        "sensitivity": loop.sensitivity, "error_m": loop.error_m if finite else None,
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
