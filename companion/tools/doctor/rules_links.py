"""Rules for links, streams and clocks, which apply to any autopilot."""

from collections.abc import Mapping

from companion.settings.mission import ConeOptions
from companion.tools.doctor.finding import Finding, Row, Rule, Severity, advice, error, warning
from companion.tools.doctor.rules_watched import (
    CONSOLE,
    ECHO,
    GARBAGE,
    LATE,
    NO_ANSWER,
    OLD_VERSION,
    REFUSED,
    first_link,
    id_conflict,
    link_one_way,
    link_signature,
    link_silent,
    no_autopilot,
    open_links,
    unanswered,
    wrong_system,
)
from companion.tools.doctor.snapshot import UNREADABLE, Snapshot
from drivers.endpoint import parse_endpoint
from drivers.mavlink.requests import INSTEAD

_ERROR, _WARNING, _ADVICE = Severity.ERROR, Severity.WARNING, Severity.ADVICE
ESSENTIAL = ("ATTITUDE_QUATERNION", "LOCAL_POSITION_NED", "EXTENDED_SYS_STATE")
"""Messages without which the service can neither report to an autopilot nor fly it."""
_LIMITED_SHARE = 0.1
"""Share of the frames with a pad that may be too dark or too bright at the camera's limits."""
_GIMBAL_HZ = 10.0  # rate of a gimbal's reports below which most frames have no report near them
_GIMBAL_SILENT_HZ = 0.5  # rate below which there are no reports
_EXPECTED = {"other_sentence", "other_message", "other_receiver", "other_ship"}
"""Reasons for which reports of a ship are not used, and that are no fault."""
_JUMP_MIN_S = 1.0  # a restart or a second autopilot makes a greater one, a simulator on a busy machine a smaller


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


def _streams_refused(p: Snapshot) -> str:
    """Return the streams that the autopilot refuses to send."""
    a = p.autopilot
    answered = {} if a is None else {n: a.rates_hz.get(INSTEAD.get(n, ""), 0.0) for n, r in a.refused.items() if r != NO_ANSWER}
    return ", ".join(sorted(n for n, instead_hz in answered.items() if n in ESSENTIAL and instead_hz < 0.2))


def _streams_silent(p: Snapshot) -> str:
    """Return the streams that were accepted but do not arrive."""
    a = p.autopilot
    if a is None or p.seconds < 3.0 or unanswered(p):
        return ""
    received = {n for n, rate in a.rates_hz.items() if rate >= 0.2}
    asked = [n for n in ESSENTIAL if n in a.wanted_hz and a.refused.get(n, NO_ANSWER) == NO_ANSWER]
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
    for link in open_links(p):
        total = link.messages + link.lost
        if total >= 50 and link.lost > 0.05 * total:
            return link.url, 100 * link.lost / total
    return None


def _other_size(p: Snapshot) -> tuple[int, ...] | None:
    """Return the size of the frames, and another one in the camera's file."""
    sent, described = p.service.frame_size, p.service.camera_size
    return None if sent is None or described is None or sent == described else (*sent, *described)


RULES: tuple[Rule, ...] = (
    Row("link-down", _ERROR, lambda p: next((link for link in p.links if link.down is not None), None),
        "{0.url} is not open",
        "{0.down}"),
    link_silent, REFUSED, CONSOLE, ECHO, GARBAGE, LATE, id_conflict, link_signature, OLD_VERSION,
    Row("link-lossy", _WARNING, _lossy,
        "{0[0]}: {0[1]:.0f} % of the messages are lost",
        "raise the speed to 921600, connect RTS/CTS, or ask for fewer streams on that port"),
    Row("link-unsigned", _ADVICE,
        lambda p: first_link(p, lambda link: link.signed is False and not parse_endpoint(link.url).is_private),
        "{0.url}: not signed: the first sender to that address can be taken for the autopilot",
        "decklander keys make FILE, keys install --link URL FILE, then signing_key_file; or keep it to loopback"),
    Row("link-unknown-senders", _ADVICE,
        lambda p: None if p.autopilot is None else first_link(p, lambda link: link.unknown_senders > 20),
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
