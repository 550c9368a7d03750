"""Rules for links, streams and clocks, which apply to any autopilot."""

from collections.abc import Callable, Mapping

from companion.settings.mission import ConeOptions
from companion.tools.doctor.finding import Finding, Row, Rule, Severity, advice, error, warning
from companion.tools.doctor.snapshot import UNREADABLE, LinkSnapshot, Snapshot
from drivers.endpoint import parse_endpoint
from drivers.mavlink.requests import INSTEAD

_ERROR, _WARNING, _ADVICE = Severity.ERROR, Severity.WARNING, Severity.ADVICE
ESSENTIAL = ("ATTITUDE_QUATERNION", "LOCAL_POSITION_NED", "EXTENDED_SYS_STATE")
"""Messages without which the service can neither report to an autopilot nor fly it."""
_LIMITED_SHARE = 0.1
"""Share of the frames with a pad that may be too dark or too bright at the camera's limits."""
_GIMBAL_HZ = 10.0  # rate of a gimbal's reports below which most frames have no report near them
_GIMBAL_SILENT_HZ = 0.5  # rate below which there are no reports
_NO_ANSWER = -1  # result of a request that was not answered
_EXPECTED = {"other_sentence", "other_message", "other_receiver", "other_ship"}
"""Reasons for which reports of a ship are not used, and that are no fault."""
_LISTED_MAX = 6  # systems that are listed
_JUMP_MIN_S = 1.0  # a restart or a second autopilot makes a greater one, a simulator on a busy machine a smaller
_REFUSED_MIN = 2  # refused datagrams that may happen: a peer that starts
_LATE_MIN = 20  # late messages that may happen: a line that stood still for a moment
_PROMPT = 16
"""Least bytes that are taken for a console: a prompt has more."""


def _open(p: Snapshot) -> list[LinkSnapshot]:
    return [link for link in p.links if link.down is None]


def _first(p: Snapshot, fault: Callable[[LinkSnapshot], bool]) -> LinkSnapshot | None:
    """Return the first open link with a fault."""
    return next((link for link in _open(p) if fault(link)), None)


def link_silent(p: Snapshot) -> Finding | None:
    """Find an open link on which no byte arrives."""
    for link in _open(p):
        refused = link.refused_datagrams > _REFUSED_MIN  # the rule link-refused says more
        if link.bytes_in == 0 and not refused and (p.seconds >= 2.0 or p.autopilot is None):
            serial = "check RX/TX wiring and, on the autopilot, SERIALn_PROTOCOL 2 (ArduPilot) or MAV_n_CONFIG (PX4)"
            net = "check that the autopilot (or mavlink-router) sends to this address and port, and the firewall"
            return error("link-silent", f"{link.url}: not one byte in {p.seconds:.0f} s", serial if "serial" in link.url else net)
    return None


def link_signature(p: Snapshot) -> Finding | None:
    """Find a link that is signed on one side only, or with another key."""
    for link in _open(p):
        if link.refused_time > 0:
            behind = f"{link.behind_s:.0f} s" if abs(link.behind_s) < 86_400 else f"{link.behind_s / 86_400:.1f} days"
            return error(
                "link-signature",
                f"{link.url}: {link.refused_time} messages signed with our key are refused for the time of their signature, "
                f"which is {behind} behind ours",
                "let the autopilot get the time first (its GNSS fix), or set the clock that is wrong; a new sender may be a "
                "minute behind, and none may use one time twice",
            )
        if link.refused_signature > 0:
            return error(
                "link-signature",
                f"{link.url}: {link.refused_signature} messages refused for their signature",
                "use the same key on both sides; after a key change restart both; check that the clocks agree to a minute",
            )
    return None


def _old_link(p: Snapshot) -> LinkSnapshot | None:
    return next((link for link in _open(p) if link.messages >= 8 and link.old_version > 0.5 * link.messages), None)


def wrong_system(p: Snapshot) -> Finding | None:
    """Find a wished system id that no autopilot has, while others are present."""
    there = sorted({one.system for one in p.systems if one.hovers})
    if p.autopilot is not None or not p.wanted_system or not there:
        return None
    names = " or ".join(map(str, there))
    return error(
        "wrong-system",
        f"system {p.wanted_system} is silent; found: {_listed(p)}",
        f"give --system {names}, and vehicle.system_id = {names} in the settings; an autopilot's own id is SYSID_THISMAV "
        "(MAV_SYSID since ArduPilot 4.7) or MAV_SYS_ID (PX4)",
    )


def no_autopilot(p: Snapshot) -> Finding | None:
    """Find links with messages but no autopilot of a copter."""
    if p.autopilot is not None or wrong_system(p) is not None or not any(link.messages > 0 for link in p.links):
        return None
    others = [one for one in p.systems if one.stack]
    if others:
        fix = "this service lands copters: check the firmware, the vehicle's frame type and the link"
        if any(one.component != 1 for one in others):
            fix = "an autopilot is expected as component 1: set its component id to 1"
        return error("no-autopilot", f"no HEARTBEAT of a copter's autopilot (component 1); found: {_listed(p)}", fix)
    output = f"found: {_listed(p)}" if p.systems else "nothing sends HEARTBEATs"
    return error(
        "no-autopilot",
        f"MAVLink messages come, but no HEARTBEAT of a copter's autopilot (component 1); {output}",
        "check the vehicle's frame type and that this link reaches the autopilot, not only a ground station; check --system",
    )


def _listed(p: Snapshot) -> str:
    shown = [str(one) if one.component == 1 or not one.stack else f"{one}, component {one.component}" for one in p.systems]
    return ", ".join(shown[:_LISTED_MAX]) + (f" and {len(shown) - _LISTED_MAX} more" if len(shown) > _LISTED_MAX else "")


def several_autopilots(p: Snapshot) -> Finding | None:
    """Find several vehicles on one network, where the service may choose the wrong one."""
    a = p.autopilot
    known = any(one.name == "several-autopilots" for one in p.id_conflicts)  # `id_conflict` says more
    if a is not None and a.others and not p.wanted_system and not known:
        there = ", ".join(str(one) for one in p.systems if one.hovers and one.system in a.others) or ", ".join(map(str, a.others))
        return warning(
            "several-autopilots",
            f"system {a.system} was listened to; there too: {there}",
            f"name the one that is meant by --system and vehicle.system_id ({a.system} or {' or '.join(map(str, a.others))}); "
            "each vehicle needs an id of its own (SYSID_THISMAV, MAV_SYS_ID)",
        )
    return None


def id_conflict(p: Snapshot) -> Finding | None:
    """Find a conflict about who is the autopilot, or another program that uses our ids."""
    for one in sorted(p.id_conflicts, key=lambda one: not one.blocks):
        return (error if one.blocks else warning)(one.name, one.what, one.fix)
    return None


def unanswered(p: Snapshot) -> bool:
    """Return whether an autopilot sends messages but no answers: its silence is then no refusal, and nothing is absent."""
    a = p.autopilot
    if a is None or not p.links or not a.wanted_hz or a.parameters:
        return False
    return (
        bool(a.refused)
        and all(result == _NO_ANSWER for result in a.refused.values())
        and (p.sync is None or p.sync.round_trip_s is None)
    )


def link_one_way(p: Snapshot) -> Finding | None:
    """Find a link on which we receive the autopilot and it does not receive us."""
    if not unanswered(p) or p.autopilot is None:
        return None
    rule, why, fix = (
        "link-one-way",
        "",
        "check the wire from our TX to its RX, and for a radio or router that passes one way only",
    )
    if any(not link.signed and link.with_signature > 0.5 * link.messages for link in _open(p)):
        rule, why = "link-signature", "; it signs its messages, and ours carry no signature"
        fix = "give its key: --signing-key FILE, vehicle.signing_key_file; keys install over USB replaces a lost one"
    elif _old_link(p) is not None:
        why = "; it speaks MAVLink 1, and something between drops MAVLink 2"
        fix = "put a router or radio there that passes MAVLink 2, and set SERIALn_PROTOCOL 2 (ArduPilot) or MAV_PROTO_VER 2 (PX4)"
    what = f"system {p.autopilot.system} sends, but answers nothing: no parameter, no stream, no TIMESYNC"
    return error(rule, what + why, fix)


def _streams_refused(p: Snapshot) -> str:
    """Return the streams that the autopilot refuses to send."""
    a = p.autopilot
    answered = {} if a is None else {n: a.rates_hz.get(INSTEAD.get(n, ""), 0.0) for n, r in a.refused.items() if r != _NO_ANSWER}
    return ", ".join(sorted(n for n, instead_hz in answered.items() if n in ESSENTIAL and instead_hz < 0.2))


def _streams_silent(p: Snapshot) -> str:
    """Return the streams that were accepted but do not arrive."""
    a = p.autopilot
    if a is None or p.seconds < 3.0 or unanswered(p):
        return ""
    received = {n for n, rate in a.rates_hz.items() if rate >= 0.2}
    asked = [n for n in ESSENTIAL if n in a.wanted_hz and a.refused.get(n, _NO_ANSWER) == _NO_ANSWER]
    return ", ".join(n for n in asked if n not in received and INSTEAD.get(n, n) not in received)


def _attitude_slow(p: Snapshot) -> tuple[float, float] | None:
    """Return the rate of an attitude stream too slow to correct for the tilt, and the one that was requested, Hz."""
    a = p.autopilot
    if a is None:
        return None
    rate = max(a.rates_hz.get(name, 0.0) for name in ("ATTITUDE_QUATERNION", INSTEAD["ATTITUDE_QUATERNION"]))
    return (rate, a.wanted_hz.get("ATTITUDE_QUATERNION", 100.0)) if 0.2 <= rate < 30.0 else None


def clock_far(p: Snapshot) -> Finding | None:
    """Find a round trip that is too long for clock synchronization; PX4 refuses to converge beyond 10 ms."""
    if p.sync is None or p.autopilot is None or p.sync.round_trip_s is None:
        return None
    limit_s = 0.010 if p.autopilot.stack == "PX4" else 0.040
    if p.sync.round_trip_s <= limit_s:
        return None
    found = f"the shortest TIMESYNC round trip is {1e3 * p.sync.round_trip_s:.0f} ms"
    fix = "connect the autopilot by wire (serial 921600, USB, Ethernet), not by radio or Wi-Fi"
    if p.autopilot.stack == "PX4":
        return error("clock-far", f"{found}: PX4 never converges and then ignores our stamps", fix)
    return warning("clock-far", f"{found}: stamps are known to {500 * p.sync.round_trip_s:.0f} ms", fix)


def _few_frames(p: Snapshot) -> str | None:
    """Return the words for a camera with too low a frame rate."""
    rate = p.service.frame_rate_hz
    if rate is None or rate >= 10.0:
        return None
    return "no frame comes" if rate == 0.0 else f"only {rate:.1f} frames a second come"


def exposure_limited(p: Snapshot) -> Finding | None:
    """Find a camera that refuses the requested exposure, or whose limits leave the pad too dark or too bright."""
    counts = p.service.exposure
    if refused := int(counts.get("refused", 0)):
        return warning(
            "exposure-refused",
            f"the camera refused {refused} exposures",
            'the journal has the reason; without a cure let camera.exposure.mode be "camera"',
        )
    tracked, dark, bright = (counts.get(f"frames_{name}", 0.0) for name in ("pad", "dark", "bright"))
    if tracked and max(dark, bright) > _LIMITED_SHARE * tracked:
        return warning(
            "exposure-limited",
            f"the pad was too {'dark' if dark > bright else 'bright'} in {max(dark, bright) / tracked:.0%} of its frames, "
            "at the limits of the camera",
            "too dark: more light, a faster lens, or a greater expert.camera.exposure.blur_px; too bright: a grey filter",
        )
    return None


def gimbal_silent(p: Snapshot) -> Finding | None:
    """Find a gimbal whose attitude does not come, or comes too seldom."""
    gimbal = p.service.gimbal or p.gimbal
    if gimbal is None or gimbal.rate_hz >= _GIMBAL_HZ:
        return None
    counts = _counted(gimbal.refused)
    refused = f"; refused: {counts}" if counts else ""
    if gimbal.rate_hz < _GIMBAL_SILENT_HZ:
        return error(
            "gimbal-silent",
            f"gimbal {gimbal.device_id} does not report its attitude{refused}",
            "correct camera.gimbal.device_id, or let the autopilot forward its messages: every frame is refused without them",
        )
    return warning(
        "gimbal-slow",
        f"gimbal {gimbal.device_id} reports only {gimbal.rate_hz:.1f} times a second{refused}",
        "raise the rate in the gimbal or the autopilot (SRn_EXTRA3): most frames fall between two reports and are refused",
    )


def ship_place(p: Snapshot) -> Finding | None:
    """Find settings about the ship's place that do not go together."""
    found = p.service.ship_place
    if found is None:
        return None
    return (error if found.refuses else advice)("ship-place", found.what, found.fix)


def _counted(refused: Mapping[str, int]) -> str:
    """Return reasons with their numbers, the most frequent first."""
    return ", ".join(f"{why} {n}" for why, n in sorted(refused.items(), key=lambda i: -i[1]) if n)


def _ship_silent(p: Snapshot) -> str | None:
    """Return what a running service says that expects the ship's place and takes none."""
    refused = _counted(p.service.places_refused)
    return None if p.service.places_taken != 0 else f"; refused: {refused}" if refused else ": nothing arrives"


def _bad_sources(p: Snapshot) -> str:
    """Return the ship's sources that are of no use because of what they report, with the reasons."""
    sources = [one for one in p.service.ship_sources if one.name != UNREADABLE] or p.service.ship_sources
    of_no_use = [(one, {why: n for why, n in one.unused.items() if why not in _EXPECTED}) for one in sources]
    return "; ".join(f"{one.name} ({_counted(why)})" for one, why in of_no_use if why and not one.used)


def _lossy(p: Snapshot) -> tuple[str, float] | None:
    """Return the address and the loss in percent of a link that loses messages."""
    for link in _open(p):
        total = link.messages + link.lost
        if total >= 50 and link.lost > 0.05 * total:
            return link.url, 100 * link.lost / total
    return None


def _other_size(p: Snapshot) -> tuple[int, ...] | None:
    """Return the size of the frames, and another one in the camera's file."""
    sent, described = p.service.frame_size, p.service.camera_size
    return None if sent is None or described is None or sent == described else (*sent, *described)


_REFUSED = Row(
    "link-refused",
    _ERROR,
    lambda p: _first(p, lambda link: link.refused_datagrams > _REFUSED_MIN and link.bytes_in == 0),
    "{0.url}: {0.refused_datagrams} messages refused, no program listens there",
    "start the autopilot's side or the router, or correct address and port",
)


def _is_console(link: LinkSnapshot) -> bool:
    """Return whether text came and not one message: of bytes that a wrong speed makes, a third are letters."""
    return link.messages == 0 and link.bytes_in >= _PROMPT and link.text > 0.7 * link.bytes_in


_CONSOLE = Row(
    "link-console",
    _ERROR,
    lambda p: _first(p, _is_console),
    "{0.url}: what comes is text ({0.bytes_in} bytes) and no MAVLink: a console or a log is on that port",
    "disable it (Raspberry Pi: raspi-config, serial port, no login shell; ArduPilot: SERIALn_PROTOCOL 2), or use another port",
)
_ECHO = Row(
    "link-echo",
    _ERROR,
    lambda p: _first(p, lambda link: link.echoed > 3 and link.echoed >= 0.8 * link.messages),
    "{0.url}: our own messages come back ({0.echoed}), and hardly anything else: the line echoes",
    "connect the autopilot's TX to our RX and ours to its: joined wires, one wire for both ways or a console that echoes do this",
)
_GARBAGE = Row(
    "link-garbage",
    _ERROR,
    lambda p: _first(p, lambda link: link.bytes_in > 200 and link.damaged > 2 * max(link.messages, 1) and not _is_console(link)),
    "{0.url}: {0.bytes_in} bytes but {0.messages} messages, the rest is damaged",
    "set the same speed on both sides (SERIALn_BAUD, SER_TELn_BAUD), common ground, shorter wires",
)
_LATE = Row(
    "link-late",
    _WARNING,
    lambda p: _first(p, lambda link: link.late > _LATE_MIN),
    "{0.url}: {0.late} messages of ours were dropped, because the line did not take them in time",
    "raise its speed to 921600, and check its flow control (RTS/CTS) and the USB adapter",
)
_OLD_VERSION = Row(
    "link-mavlink1",
    _WARNING,
    lambda p: None if unanswered(p) else _old_link(p),
    "{0.url}: the other side speaks MAVLink 1",
    "set SERIALn_PROTOCOL 2 (ArduPilot) or MAV_PROTO_VER 2 (PX4): version 1 has no position in LANDING_TARGET",
)
WATCHED: tuple[Rule, ...] = (
    id_conflict, link_silent, _REFUSED, _CONSOLE, _ECHO, _GARBAGE, _LATE, link_signature, _OLD_VERSION, link_one_way,
    wrong_system, no_autopilot,
)  # fmt: skip
"""Rules that a running service applies all the time."""
RULES: tuple[Rule, ...] = (
    Row("link-down", _ERROR, lambda p: next((link for link in p.links if link.down is not None), None),
        "{0.url} is not open",
        "{0.down}"),
    link_silent, _REFUSED, _CONSOLE, _ECHO, _GARBAGE, _LATE, id_conflict, link_signature, _OLD_VERSION,
    Row("link-lossy", _WARNING, _lossy,
        "{0[0]}: {0[1]:.0f} % of the messages are lost",
        "raise the speed to 921600, connect RTS/CTS, or ask for fewer streams on that port"),
    Row("link-unsigned", _ADVICE,
        lambda p: _first(p, lambda link: link.signed is False and not parse_endpoint(link.url).is_private),
        "{0.url}: not signed: the first sender to that address can be taken for the autopilot",
        "decklander keys make FILE, keys install --link URL FILE, then signing_key_file; or keep it to loopback"),
    Row("link-unknown-senders", _ADVICE,
        lambda p: None if p.autopilot is None else _first(p, lambda link: link.unknown_senders > 20),
        "{0.url}: {0.unknown_senders} messages of systems that may not command and get no messages",
        "where one is your ground station, name its system in vehicle.operators (QGroundControl is 255), or sign"),
    link_one_way, wrong_system, no_autopilot, several_autopilots,
    Row("stream-refused", _ERROR, _streams_refused,
        "the autopilot refuses to send {0}",
        "it answers to SET_MESSAGE_INTERVAL with an error: update the firmware, or enable the message in its build"),
    Row("stream-silent", _ERROR, _streams_silent,
        "requested and not received: {0}",
        "LOCAL_POSITION_NED needs a position estimate (GNSS or flow, EKF healthy); for the rest another program "
        "(a ground station's stream rates, SRn_*) turns streams off: set its rates to 0"),
    Row("attitude-slow", _WARNING, _attitude_slow,
        "attitude comes at {0[0]:.0f} Hz, {0[1]:.0f} were requested",
        "use a faster link (921600 on serial, USB, Ethernet): at 10 Hz a swinging vehicle's tilt is wrong by degrees"),
    Row("clock-not-locked", _ERROR,
        lambda p: p.autopilot is not None and p.sync is not None and not p.sync.locked and not unanswered(p),
        "TIMESYNC is not answered, or never twice alike: instants of the autopilot are known to some 20 ms only",
        "check that nothing between filters TIMESYNC (a router, a ground station's forwarding)"),
    clock_far,
    Row("clock-jumps", _WARNING, lambda p: None if p.sync is None or p.sync.jumped_s < _JUMP_MIN_S else p.sync,
        "the autopilot's clock jumped by {0.jumped_s:.1f} s (jumps: {0.jumps})",
        "it reboots (power?), or two autopilots share one system id: give each its own"),
    Row("settings-files", _ERROR, lambda p: p.service.files_fault,
        "{0}",
        "correct the file or the setting that names it; its part cannot begin"),
    Row("settings-idle", _ADVICE, lambda p: "; ".join(p.service.without_effect),
        "{0}",
        "take these keys out, or switch on what they belong to"),
    Row("limits-wide", _WARNING, lambda p: "; ".join(p.service.beyond_sound),
        "{0}",
        "leave these keys out, or make sure that this vehicle may land so"),
    Row("feet-not-said", _ADVICE, lambda p: p.service.feet_below_m == ConeOptions().feet_below_m and p.service.feet_below_m,
        "guidance.cone.feet_below_m is {0:g} m, an AR.Drone's: taller feet are so much nearer to the deck at the gate",
        "measure from the autopilot down to the ends of the feet, and set it"),
    Row("lens-nominal", _WARNING, lambda p: "; ".join(p.service.lens_assumed),
        "{0}",
        "print the board, film it, and give what decklander calibrate camera writes as camera.file"),
    Row("camera-file", _ERROR, lambda p: p.service.camera_fault,
        "{0}",
        "correct the file; decklander config check names every key"),
    Row("camera-device", _ERROR, lambda p: p.service.device_fault,
        "camera: {0}",
        "check cable and power; v4l2-ctl --list-devices (libcamera: cam -l) names what is there, and its user must be in the "
        "group video; stop whatever else holds it"),
    Row("camera-size", _ERROR, _other_size,
        "the camera sends {0[0]}x{0[1]}, its file describes {0[2]}x{0[3]}",
        "calibrate at the size that is used, or set the size of the calibration: no frame can be used like this"),
    Row("camera-slow", _WARNING, _few_frames,
        "{0}",
        "check cable and USB power, give the camera its own bus, and more light: exposure time limits the rate"),
    exposure_limited, gimbal_silent,
    Row("broker", _WARNING, lambda p: None if p.service.broker_fault is None else p.service,
        "MQTT broker {0.broker}: {0.broker_fault}",
        "start the broker, or correct its address; landing does not need it, telemetry does"),
    Row("drone", _ERROR, lambda p: None if p.service.drone_fault is None else p.service,
        "AR.Drone at {0.drone}: {0.drone_fault}",
        "join its Wi-Fi (ardrone2_...), check that this host has an address 192.168.1.x, and power-cycle the drone"),
    ship_place,
    Row("ship-source", _WARNING, lambda p: p.service.ship_fault,
        "{0}",
        "check address, cable and firewall; if the service runs it has the port: let it answer with [http], and examine again"),
    Row("ship-sentences", Severity.ADVICE, _bad_sources,
        "of the ship's reports these are not used: {0}",
        "docs/rendezvous.md says what each reason means; a sensor whose data are not good has to settle or be repaired first"),
    Row("ship-silent", _WARNING, _ship_silent,
        "the service took no place of the ship{0}",
        "docs/rendezvous.md says what each reason means; nothing arrives: check the address, the port and the firewall"),
)  # fmt: skip
