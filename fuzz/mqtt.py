"""Fuzz what comes from a broker: commands, a ship's reports, other drones' messages for `watch`; and the spool after a crash."""

import math
import shutil
import tempfile
import zlib
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import msgspec

from companion.parts.mqtt import messages, watch_view
from companion.parts.mqtt.commands import CommandHandler, ShipReportReader, signed
from companion.parts.mqtt.messages import (
    BeliefReport,
    CommandReply,
    CommandReport,
    EventMessage,
    FlowReport,
    HealthReport,
    MethodReport,
    PartReport,
    SightingMessage,
    StageReport,
    StateMessage,
    StatusMessage,
    VehicleState,
    encode,
)
from companion.parts.mqtt.spool import Spool
from companion.parts.mqtt.topics import ROOT, Topics, split
from companion.parts.mqtt.watch_model import WatchModel
from estimator.contracts.errors import BadInput
from estimator.contracts.estimates import PathName
from estimator.contracts.samples import GeoFix
from estimator.contracts.time import MonoNs
from fuzz.target import SHARED_MEMORY, Choices, Target, block

SESSION, RUN = "0123456789ab", "fedcba9876543210"
KEY = bytes(range(32))


class _Operated:
    """A pilot that obeys every command, or none."""

    def __init__(self, refusal: str | None) -> None:
        self._refusal = refusal

    def start(self) -> str | None:
        return self._refusal

    def pause(self) -> str | None:
        return self._refusal

    def abort(self) -> str | None:
        return self._refusal

    def clear(self) -> str | None:
        return self._refusal

    def steer_by(self, path: PathName) -> str | None:
        return self._refusal

    def record(self, on: bool) -> str | None:
        return self._refusal


def run_command(data: bytes) -> None:
    """Send payloads to the command topic, signed or not: each gets one answer, on a topic of ours, that can be decoded."""
    choices = Choices(data)
    how = choices.number(1)
    topics, key = Topics("drone"), KEY if how & 2 else None
    command_handler = CommandHandler(topics, SESSION, _Operated("not now" if how & 1 else None), RUN, key)
    now, measured_at = MonoNs(1_000_000_000_000), 0
    while choices:
        how = choices.number(1)
        reply_to = choices.block().decode("utf-8", "replace") if how & 2 else None
        payload = choices.block()
        if how & 4:
            payload = signed(KEY, topics.command, payload)
        judged = command_handler.take(payload, now, retained=bool(how & 1), reply_to=reply_to)
        measured_at += 1
        now = MonoNs(now + (how >> 3) * 1_000_000_000)
        assert judged.topic.startswith(topics.reply)
        assert messages.decode("reply", encode(judged.reply)) == judged.reply
        assert not (judged.reply.accepted and how & 1 and not judged.repeated), "a retained command was carried out"
        assert not (judged.reply.accepted and key is not None and not how & 4), "an unsigned command was carried out"
    assert sum(command_handler.counts.values()) == measured_at


def command_seeds() -> Iterator[bytes]:
    """Yield each command; a repeated, a late, a retained one; and one with the topic of another drone."""
    until = 1_000_000_000_000 + 20_000_000_000
    usual = {"run": RUN, "expires_ns": until}
    rows = [
        {"command": "start", "id": "1", **usual},
        {"command": "pause", "id": "2", **usual, "reply_to": f"{ROOT}/drone/reply/me"},
        {"command": "abort", "id": "3", **usual, "reply_to": "elsewhere"},
        {"command": "path", "id": "4", **usual, "path": "dead_reckoning"},
        {"command": "record", "id": "5", **usual, "on": True},
        {"command": "start", "id": "1", **usual},
    ]
    yield b"\2" + b"".join(b"\x0c" + block(msgspec.json.encode(row)) for row in rows)
    yield b"\0" + b"".join(b"\x09" + block(msgspec.json.encode(row)) for row in rows)
    for row in rows[:5]:
        yield b"\1\0" + block(msgspec.json.encode(row))
    yield b"\0\2" + block(b"decklander/v1/drone/reply/x") + block(msgspec.json.encode(rows[0])) + b"\0" + block(b'{"id": "9"}')


def run_ship_report(data: bytes) -> None:
    """Send payloads to the topic of the ship, signed or not: each is a place on the Earth, not ahead of time, or one refusal."""
    choices = Choices(data)
    topics, key = Topics("drone"), KEY if choices.number(1) & 1 else None
    reader, now, sent = ShipReportReader(topics, RUN, key), 1_000_000_000_000, 0
    while choices:
        how, payload = choices.number(1), choices.block()
        if how & 2:
            payload = signed(KEY, topics.vessel, payload)
        samples, sent = reader.samples(payload, MonoNs(now), retained=bool(how & 1)), sent + 1
        now += (how >> 2) * 100_000_000
        assert not (samples and (how & 1 or (key is not None and not how & 2)))
        for sample in samples:
            assert sample.stamp.measured_at <= sample.stamp.received_at
            assert not isinstance(sample, GeoFix) or abs(sample.place.latitude_rad) <= 0.5 * math.pi
    assert sum(reader.counts.values()) == sent


def ship_report_seeds() -> Iterator[bytes]:
    """Yield a whole report, the least of one, a copy, and one ahead of time."""
    least = {"run": RUN, "at_ns": 999_000_000_000, "latitude_deg": 54.4, "longitude_deg": -10.2}
    whole = least | {
        "at_ns": 999_500_000_000, "height_m": 6.5, "sigma_m": 2.5, "speed_m_s": 1.5, "course_deg": 350.0, "heading_deg": 359.9,
    }  # fmt: skip
    rows = [block(msgspec.json.encode(row)) for row in (least, whole, whole, whole | {"at_ns": 2_000_000_000_000})]
    yield b"\0" + b"".join(b"\4" + row for row in rows)
    yield b"\1" + b"".join(b"\6" + row for row in rows)


def run_watch(data: bytes) -> None:
    """Pass topics and payloads to `decklander watch`: processed or counted, and the view can be drawn."""
    choices = Choices(data)
    model, now_s = WatchModel(), 0.0
    while choices:
        topic = choices.block().decode("utf-8", "replace")
        now_s += choices.number(1) * 0.1
        split(topic)
        model.on_message(topic, choices.block(), now_s)
    _draw(model, now_s)


def _draw(model: WatchModel, now_s: float) -> None:
    watch_view.screen(model, now_s, 100, 40)


def watch_seeds() -> Iterator[bytes]:
    """Yield one of each message of the drone, and numbers at the ends of their ranges."""
    belief = BeliefReport(
        path="ekf", d_body_pad_level_m=(1.0, 2.0, 3.0), v_pad_level_m_s=(0.1, 0.0, 1e300), yaw_rad=None,
        sigma_d_m=(0.1, 0.1, 0.1), sigma_v_m_s=(0.1, 0.1, 0.1), sigma_yaw_rad=3.0, sighted_age_s=0.1, consistent=True,
    )  # fmt: skip
    found = MethodReport(d_body_pad_level_m=(1.0, 2.0, 3.0), yaw_rad=0.1, yaw_ambiguous=False, cov=(0.0,) * 16, confidence=0.9)
    output = {
        "status": StatusMessage(
            session=SESSION, at_ns=1, online=True, reason="up", version="1", started_unix_s=1.7e9, started_ns=0
        ),
        "state": StateMessage(
            session=SESSION, at_ns=2, phase="descend", belief=belief, shadows=(belief,),
            order=CommandReport(kind="velocity", v_level_m_s=(0.1, 0.2, 0.3)),
            vehicle=VehicleState(mode="flying", flying=True, battery_fraction=0.5, emergency=False, link_ok=True, age_s=0.1),
        ),
        "sighting": SightingMessage(
            session=SESSION, at_ns=3, measured_at_ns=2, sequence=1, verdict="fused", chosen="ellipse",
            selected=found, methods={"ellipse": found},
        ),
        "health": HealthReport(
            session=SESSION, at_ns=4, all_up=True, parts={"vehicle": PartReport(up=True, age_s=1.0, restarts=0, last_error="")},
            flows={"Imu": FlowReport(count=1, age_s=None, rate_hz=200.0)}, frames={"fused": 3}, inputs={"ekf": {"fused": 2}},
            stages={"vision": StageReport(count=1, p50_s=0.01, p99_s=None)}, counters={"mavlink": {"lost": 1.0}},
        ),
        "event": EventMessage(
            session=SESSION, at_ns=5, id="a", spool="s", sequence=7, kind="phase", text="descend",
            data={"from": "x", "n": 1.0},
        ),
        "reply": CommandReply(session=SESSION, at_ns=6, id="1", accepted=False, reason="expired", text="late"),
    }  # fmt: skip
    rows = [block(f"{ROOT}/drone/{leaf}".encode()) + b"\1" + block(encode(message)) for leaf, message in output.items()]
    yield b"".join(rows)
    yield from rows


def run_spool(data: bytes) -> None:
    """Open a folder after a crash, a power cut or another program: read, appended to and delivered, or refused in one line."""
    choices = Choices(data)
    folder = Path(tempfile.mkdtemp(dir=SHARED_MEMORY))
    try:
        for _ in range(choices.number(1) % 5):
            how = choices.number(1)
            name = (b"name", b"delivered", b"delivered.new", b"events-%020d.log" % choices.number(1), choices.block())[how % 5]
            content = choices.block()
            if how & 0x80:
                content = b"".join(b"%08x %s\n" % (zlib.crc32(line), line) for line in content.split(b"\n"))
            with suppress(OSError, ValueError):
                (folder / name.decode("utf-8", "replace").replace("/", "_")).write_bytes(content)
        with suppress(BadInput):
            _use(Spool(folder, 1 + choices.number(2)), choices)
            again = Spool(folder, 1 << 16)
            again.peek(100)
            again.close()
    finally:
        shutil.rmtree(folder)


def _use(spool: Spool, choices: Choices) -> None:
    for _ in range(8):
        spool.append([choices.block().replace(b"\n", b" ")])
        records = spool.peek(3)
        numbers = [record.number for record in records]
        assert numbers == sorted(set(numbers))
        if records and choices.number(1) & 1:
            spool.deliver(records[-1].number)
        assert spool.waiting >= 0
    spool.close()


def spool_seeds() -> Iterator[bytes]:
    """Yield spools with waiting events, and damaged ones."""
    rows = b"\n".join(b'%d {"id": "%d"}' % (n, n) for n in range(1, 6))
    lines = b"\x83\x01" + block(rows)
    yield b"\x03" + b"\x00" + block(b"abcdef012345\n") + b"\x81" + block(b"3\n") + lines + b"\xff\x03" + block(b"{}") + b"\x01"
    yield b"\x02" + lines + b"\x83\x06" + block(b"6 {}\n8 {}\n9 {}") + b"\x00\x01" + block(b"{}") * 3
    yield b"\x01" + b"\x03\x01" + block(b"0000 1 torn\n")


TARGETS = {
    "mqtt_command": Target(run_command, command_seeds),
    "mqtt_ship_report": Target(run_ship_report, ship_report_seeds),
    "mqtt_watch": Target(run_watch, watch_seeds),
    "spool": Target(run_spool, spool_seeds),
}
