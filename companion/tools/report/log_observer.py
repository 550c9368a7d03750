"""An observer that keeps a flight's log for its report."""

import cv2

from companion.base.observer import Decision, NullObserver, ProcessedFrame
from companion.base.orders import HandledOrder
from companion.tools.report.expected_place import expected_in_body, held_rotation
from companion.tools.report.flight_log import CommandRecord, FlightLog, FrameRecord, PhaseChange
from estimator.contracts.fusion import FusionResult
from estimator.contracts.time import MonoNs


class LogObserver(NullObserver):
    """Fills `log` as the flight goes on. Frames are kept as JPEG, about 40 kB each.

    Args:
        decisions_each: keep each n-th round of guidance; a change of phase is always kept.
    """

    def __init__(self, log: FlightLog, *, decisions_each: int = 2, keep_images: bool = True) -> None:
        self.log = log
        self._decisions_each = decisions_each
        self._keep_images = keep_images
        self._rounds = 0

    def on_fusion(self, at: MonoNs, result: FusionResult) -> None:
        self.log.add_result(result)

    def on_frame(self, processed: ProcessedFrame) -> None:
        log, frame = self.log, processed.frame
        image: bytes | None = None
        if self._keep_images:
            ok, packed = cv2.imencode(".jpg", frame.px, [cv2.IMWRITE_JPEG_QUALITY, 88])
            image = packed.tobytes() if ok else None
        R_level_body = None if processed.attitude is None else processed.attitude.R_ned_body.without_heading()
        expected = expected_in_body(processed, log.steering)
        place = None if R_level_body is None or expected is None else R_level_body @ expected
        exposed_at = processed.frame.stamp.measured_at
        held, verdict = held_rotation(processed), processed.verdict
        log.frames.append(FrameRecord(exposed_at, processed.frame.seq, verdict, R_level_body, place, held, image))
        if processed.detection is not None:
            log.add_detection(processed.detection, processed.frame.stamp.measured_at)
        log.add_times(processed)

    def on_order(self, handled: HandledOrder) -> None:
        self.log.orders.append(handled)

    def on_decision(self, decision: Decision) -> None:
        log = self.log
        if not log.phases or log.phases[-1].phase != decision.phase:
            log.phases.append(PhaseChange(decision.at, decision.phase))
        log.transitions += decision.transitions
        if decision.ahead is not None:
            log.add_forecast(decision.ahead)
        self._rounds += 1
        if self._rounds % self._decisions_each:
            return
        if decision.belief is not None:
            log.estimates.append(decision.belief)
        log.estimates.extend(decision.shadows)
        if decision.command is not None:
            log.commands.append(CommandRecord(decision.at, decision.command))
