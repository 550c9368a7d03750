"""Rules for links and for who is on them, which a running service applies all the time and the doctor, too."""

from collections.abc import Callable

from companion.tools.doctor.finding import Finding, Row, Rule, Severity, error, warning
from companion.tools.doctor.snapshot import LinkSnapshot, Snapshot

_REFUSED_MIN = 2  # refused datagrams that may happen: a peer that starts
_LATE_MIN = 20  # late messages that may happen: a line that stood still for a moment
_LISTED_MAX = 6  # systems that are listed
_PROMPT = 16
"""Least bytes that are taken for a console: a prompt has more."""
NO_ANSWER = -1  # result of a request that was not answered


def open_links(p: Snapshot) -> list[LinkSnapshot]:
    """Return the links that are open."""
    return [link for link in p.links if link.down is None]


def first_link(p: Snapshot, fault: Callable[[LinkSnapshot], bool]) -> LinkSnapshot | None:
    """Return the first open link with a fault."""
    return next((link for link in open_links(p) if fault(link)), None)


def link_silent(p: Snapshot) -> Finding | None:
    """Find an open link on which no byte arrives."""
    for link in open_links(p):
        refused = link.refused_datagrams > _REFUSED_MIN  # the rule link-refused says more
        if link.bytes_in == 0 and not refused and (p.seconds >= 2.0 or p.autopilot is None):
            serial = "check RX/TX wiring and, on the autopilot, SERIALn_PROTOCOL 2 (ArduPilot) or MAV_n_CONFIG (PX4)"
            net = "check that the autopilot (or mavlink-router) sends to this address and port, and the firewall"
            return error("link-silent", f"{link.url}: not one byte in {p.seconds:.0f} s", serial if "serial" in link.url else net)
    return None


def link_signature(p: Snapshot) -> Finding | None:
    """Find a link that is signed on one side only, or with another key."""
    for link in open_links(p):
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
    return next((link for link in open_links(p) if link.messages >= 8 and link.old_version > 0.5 * link.messages), None)


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
        and all(result == NO_ANSWER for result in a.refused.values())
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
    if any(not link.signed and link.with_signature > 0.5 * link.messages for link in open_links(p)):
        rule, why = "link-signature", "; it signs its messages, and ours carry no signature"
        fix = "give its key: --signing-key FILE, vehicle.signing_key_file; keys install over USB replaces a lost one"
    elif _old_link(p) is not None:
        why = "; it speaks MAVLink 1, and something between drops MAVLink 2"
        fix = "put a router or radio there that passes MAVLink 2, and set SERIALn_PROTOCOL 2 (ArduPilot) or MAV_PROTO_VER 2 (PX4)"
    what = f"system {p.autopilot.system} sends, but answers nothing: no parameter, no stream, no TIMESYNC"
    return error(rule, what + why, fix)


REFUSED = Row(
    "link-refused",
    Severity.ERROR,
    lambda p: first_link(p, lambda link: link.refused_datagrams > _REFUSED_MIN and link.bytes_in == 0),
    "{0.url}: {0.refused_datagrams} messages refused, no program listens there",
    "start the autopilot's side or the router, or correct address and port",
)


def _is_console(link: LinkSnapshot) -> bool:
    """Return whether text came and not one message: of bytes that a wrong speed makes, a third are letters."""
    return link.messages == 0 and link.bytes_in >= _PROMPT and link.text > 0.7 * link.bytes_in


CONSOLE = Row(
    "link-console",
    Severity.ERROR,
    lambda p: first_link(p, _is_console),
    "{0.url}: what comes is text ({0.bytes_in} bytes) and no MAVLink: a console or a log is on that port",
    "disable it (Raspberry Pi: raspi-config, serial port, no login shell; ArduPilot: SERIALn_PROTOCOL 2), or use another port",
)
ECHO = Row(
    "link-echo",
    Severity.ERROR,
    lambda p: first_link(p, lambda link: link.echoed > 3 and link.echoed >= 0.8 * link.messages),
    "{0.url}: our own messages come back ({0.echoed}), and hardly anything else: the line echoes",
    "connect the autopilot's TX to our RX and ours to its: joined wires, one wire for both ways or a console that echoes do this",
)
GARBAGE = Row(
    "link-garbage",
    Severity.ERROR,
    lambda p: first_link(
        p, lambda link: link.bytes_in > 200 and link.damaged > 2 * max(link.messages, 1) and not _is_console(link)
    ),
    "{0.url}: {0.bytes_in} bytes but {0.messages} messages, the rest is damaged",
    "set the same speed on both sides (SERIALn_BAUD, SER_TELn_BAUD), common ground, shorter wires",
)
LATE = Row(
    "link-late",
    Severity.WARNING,
    lambda p: first_link(p, lambda link: link.late > _LATE_MIN),
    "{0.url}: {0.late} messages of ours were dropped, because the line did not take them in time",
    "raise its speed to 921600, and check its flow control (RTS/CTS) and the USB adapter",
)
OLD_VERSION = Row(
    "link-mavlink1",
    Severity.WARNING,
    lambda p: None if unanswered(p) else _old_link(p),
    "{0.url}: the other side speaks MAVLink 1",
    "set SERIALn_PROTOCOL 2 (ArduPilot) or MAV_PROTO_VER 2 (PX4): version 1 has no position in LANDING_TARGET",
)
WATCHED: tuple[Rule, ...] = (
    id_conflict, link_silent, REFUSED, CONSOLE, ECHO, GARBAGE, LATE, link_signature, OLD_VERSION, link_one_way,
    wrong_system, no_autopilot,
)  # fmt: skip
"""Rules that a running service applies all the time."""
