"""Connections that the operator page accepts: its own page's, by the names that this computer has."""

import socket

import pytest

from companion.parts.page.access import own_names, refused_origin
from companion.settings.http import HttpSettings

NAMES = own_names(HttpSettings(hosts="Drone.lan, bridge.example.org.,"))
OWN = socket.gethostname().partition(".")[0].lower()


@pytest.mark.parametrize(
    "host",
    [
        "127.0.0.1:8480", "192.168.1.7:8480", "[::1]:8480", "[fe80::1]", "localhost:8480", "LOCALHOST", f"{OWN}.local:8480",
        f"{OWN.upper()}.local", "drone.lan:8480", "drone.lan.", "bridge.example.org",
    ],
)  # fmt: skip
def test_its_own_page_is_let_in_by_each_of_its_names(host: str) -> None:
    assert refused_origin(f"http://{host}", host, NAMES) is None
    assert refused_origin(f"https://{host}", host.lower(), NAMES) is None


@pytest.mark.parametrize(
    "host", ["evil.example", "evil.example:8480", "localhost.evil.example", "drone.lan.evil", "1.2.3.4.nip.io"]
)
def test_a_name_that_somebody_else_points_here_is_refused_and_the_answer_names_the_setting(host: str) -> None:
    why = refused_origin(f"http://{host}", host, NAMES)
    assert why is not None
    assert "[expert.http] hosts" in why


@pytest.mark.parametrize(
    ("origin", "host"),
    [
        (None, "127.0.0.1:8480"), ("http://127.0.0.1:8480", None), ("null", "127.0.0.1:8480"), ("", ""), ("http://", ""),
        ("http://127.0.0.1:8481", "127.0.0.1:8480"), ("file://127.0.0.1", "127.0.0.1"), ("http://[::1", "[::1"),
        ("https://evil.example", "127.0.0.1"),
    ],
)  # fmt: skip
def test_the_page_of_another_is_refused(origin: str | None, host: str | None) -> None:
    assert refused_origin(origin, host, NAMES) == "this connection belongs to another page"
