"""An observer that keeps a flight's log for its report."""

from __future__ import annotations

import cv2

from companion.observer import Decision, FrameSeen, Silent
from companion.report.flight_log import CommandRecord, FlightLog, FrameRecord, PhaseChange
from estimator.contracts.time import seconds_between


class LogKeeper(Silent):
    """Fills `log` as the flight goes on. Pictures are kept as JPEG, about 40 kB each.

    Args:
        decisions_each: keep each n-th round of guidance; a change of phase is always kept.
    """

    def __init__(self, log: FlightLog, *, decisions_each: int = 2, keep_pictures: bool = True) -> None:
        self.log = log
        self._decisions_each = decisions_each
        self._keep_pictures = keep_pictures
        self._rounds = 0

    def on_frame(self, seen: FrameSeen) -> None:
        log, frame = self.log, seen.frame
        picture: bytes | None = None
        if self._keep_pictures:
            ok, packed = cv2.imencode(".jpg", frame.px, [cv2.IMWRITE_JPEG_QUALITY, 88])
            picture = packed.tobytes() if ok else None
        R_level_body = None if seen.attitude is None else seen.attitude.R_ned_body.without_heading()
        log.frames.append(FrameRecord(frame.stamp.taken, frame.seq, seen.verdict, R_level_body, picture))
        if seen.look is not None:
            log.sightings.extend(s for s in (*seen.look.methods.values(), seen.look.selected) if s is not None)
            log.stage_s.setdefault("vision", []).append(seconds_between(seen.began, seen.done))
        log.stage_s.setdefault("camera and link", []).append(frame.stamp.delay_s)
        log.delay_s.append(seconds_between(frame.stamp.taken, seen.done))

    def on_decision(self, decision: Decision) -> None:
        log = self.log
        if not log.phases or log.phases[-1].phase != decision.phase:
            log.phases.append(PhaseChange(decision.at, decision.phase))
        self._rounds += 1
        if self._rounds % self._decisions_each:
            return
        if decision.belief is not None:
            log.estimates.append(decision.belief)
        log.estimates.extend(decision.shadows)
        if decision.command is not None:
            log.commands.append(CommandRecord(decision.at, decision.command))
