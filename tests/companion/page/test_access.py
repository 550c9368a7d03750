"""The page is served to its own origin alone, by each name of this computer and behind a proxy."""

import socket

import pytest

from companion.parts.page.access import own_names, refused_origin
from companion.settings.links import HttpSettings

NAMES = own_names(HttpSettings(hosts="Drone.lan, bridge.example.org.,"))
OWN = socket.gethostname().partition(".")[0].lower()


@pytest.mark.parametrize(
    ("origin", "host", "expected"),
    [
        *((f"http://{host}", host, None) for host in (
            "127.0.0.1:8480", "[::1]:8480", "[fe80::1]", "LOCALHOST", f"{OWN}.local:8480", f"{OWN.upper()}.local", "drone.lan.",
            "bridge.example.org",
        )),
        *((f"http://{host}", host, "name it in [expert.http] hosts") for host in (
            "evil.example:8480", "localhost.evil.example", "drone.lan.evil", "1.2.3.4.nip.io",
        )),
        *((origin, host, "this connection belongs to another page") for origin, host in (
            (None, "127.0.0.1:8480"), ("http://127.0.0.1:8480", None), ("null", "127.0.0.1:8480"), ("", ""),
            ("http://127.0.0.1:8481", "127.0.0.1:8480"), ("file://127.0.0.1", "127.0.0.1"), ("http://[::1", "[::1"),
            ("https://evil.example", "127.0.0.1"),
        )),
    ],
)  # fmt: skip
def test_its_own_page_is_let_in_by_each_of_its_names_and_no_other(
    origin: str | None, host: str | None, expected: str | None
) -> None:
    why = refused_origin({name: text for name, text in (("Origin", origin), ("Host", host)) if text is not None}, NAMES)
    assert why is None if expected is None else expected in (why or "")


@pytest.mark.parametrize(
    ("origin", "headers", "expected"),
    [
        ("https://drone.lan:8443", {"Host": "drone.lan"}, "Host $http_host"),
        ("https://drone.lan:8443", {"Host": "drone.lan:8443"}, None),
        ("https://drone.lan", {"Host": "drone.lan:443"}, None),
        ("https://drone.lan:8443", {"Host": "drone.lan", "X-Forwarded-Port": "8443"}, None),
        ("https://drone.lan:8443", {"Host": "127.0.0.1:8480", "X-Forwarded-Host": "drone.lan:8443"}, None),
        ("https://drone.lan:8443", {"Host": "a", "X-Forwarded-Host": "drone.lan, b", "X-Forwarded-Port": "8443"}, None),
        ("https://drone.lan", {"Host": "127.0.0.1:8480", "X-Forwarded-Host": "drone.lan"}, None),
        ("https://drone.lan", {"Host": "127.0.0.1:8480"}, "'https://drone.lan' and Host has '127.0.0.1:8480'"),
        ("https://evil.example", {"Host": "127.0.0.1:8480", "X-Forwarded-Host": "drone.lan"}, "another page"),
        ("https://evil.example", {"Host": "127.0.0.1", "X-Forwarded-Host": "evil.example"}, "[expert.http] hosts"),
        ("https://drone.lan:x", {"Host": "drone.lan:x"}, "another page"),
        ("https://", {"Host": ""}, "another page"),
    ],
)  # fmt: skip
def test_a_proxy_passes_the_browser_s_host_on_or_the_header_is_named(origin, headers, expected):
    why = refused_origin({"Origin": origin, **headers}, NAMES)
    assert why is None if expected is None else expected in (why or "")
