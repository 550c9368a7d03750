"""`--record FILE` of the commands that fly: record one flight, with the truth of the simulator."""

from __future__ import annotations

import argparse
import math
import os
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, get_args

from companion.parts.recorder.recorder import Recorder
from companion.parts.recorder.setup import about, recorder_to_file, wall_offset_ns
from companion.recording.records import ContactRecord, TruthRecord
from companion.settings.load import Settings, body_camera
from companion.settings.recorder import FrameForm
from drivers.clock import SystemClock
from estimator.contracts.errors import BadInput
from estimator.contracts.geometry import Rotation
from sitl.world.truth import Touchdown, Truth


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of a command that records its flight."""
    parser.add_argument(
        "--record", type=Path, metavar="FILE", help="record the flight into this file (MCAP; see docs/recordings.md)"
    )
    parser.add_argument(
        "--record-frames",
        choices=get_args(FrameForm),
        default="jpeg",
        help="encode recorded frames like this (default: jpeg)",
    )


@contextmanager
def recording(
    args: argparse.Namespace, settings: Settings, flight: Mapping[str, str], *, live: bool
) -> Iterator[Recorder | None]:
    """Open the recorder, or yield None without `--record`. A `live` flight is placed in wall time and never waits for the disk.

    The file begins with the first record: a flight that is refused leaves none, and an older file of that name as it is.

    Raises:
        BadInput: the file cannot be made.
    """
    if args.record is None:
        yield None
        return
    _require_writable(args.record)
    offset_ns = wall_offset_ns(SystemClock()) if live else 0
    described = about(settings, flight, offset_ns)
    with recorder_to_file(args.record, body_camera(settings), described, frames=args.record_frames, live=live) as recorder:
        yield recorder
    if recorder.why or recorder.faults:
        sys.stderr.write(f"the recording is incomplete: {recorder.why or 'a fault of the recorder'}\n")


def _require_writable(path: Path) -> None:
    there = os.path.lexists(path)
    if there and not path.is_file():
        raise BadInput(f"--record {path}: is there already and is no regular file; name a new file")
    try:
        path.open("ab").close()
        if not there:
            path.unlink()
    except OSError as why:
        raise BadInput(f"--record {path}: {why.strerror or why}") from why


def truth_record(truth: Truth) -> TruthRecord:
    """Return the record of the simulator's truth."""
    touchdown = None if truth.touchdown is None else _contact(truth.touchdown)
    d, v = truth.d_body_pad_level.tolist(), truth.v_pad_level.tolist()
    body, pad = (R.matrix.ravel().tolist() for R in (truth.R_ned_body, truth.R_ned_pad))
    return TruthRecord(
        int(truth.at), d, v, truth.yaw_rad, truth.phase.name.lower(), touchdown, body, pad, truth.p_pad_ned.tolist()
    )


def truth_from_log(record: Mapping[str, Any]) -> TruthRecord:
    """Return the record of one line of the simulated drone's truth log (`sitl.emulators.ardrone.truth_log`)."""
    touched = record["touchdown"]
    touchdown = None if touched is None else ContactRecord(touched["at"], *(touched[n] for n in _CONTACT))
    yaw = math.remainder(record["yaw_rad"], math.tau)
    d, v = ([float(x) for x in record[name]] for name in ("d_body_pad_level_m", "v_pad_level_m_s"))
    body, pad = (Rotation.from_quat(record[f"quat_ned_{name}_wxyz"]).matrix.ravel().tolist() for name in ("body", "pad"))
    return TruthRecord(record["at_ns"], d, v, yaw, record["phase"], touchdown, body, pad, record["p_pad_ned_m"])


_CONTACT = ("surface", "on_pad", "lateral_m", "yaw_rad", "vertical_speed_m_s", "lateral_speed_m_s")


def _contact(t: Touchdown) -> ContactRecord:
    numbers = (float(x) for x in (t.lateral_m, t.yaw_rad, t.vertical_speed_m_s, t.lateral_speed_m_s))
    return ContactRecord(int(t.at), t.surface, t.on_pad, *(x if math.isfinite(x) else None for x in numbers))
