"""The operator page's server with real sockets and the real pilot: who may watch, who may command, and what a loss leads to."""

import asyncio
import json
import os
import re
import ssl
import tempfile
from collections.abc import Callable, Coroutine
from pathlib import Path

import aiohttp
import av
import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.base.http_server import ConnectionLimits
from companion.base.mission import Event, Reason, ReasonCause, State, StateChange
from companion.base.observer import Decision
from companion.parts.page import endpoint, viewer
from companion.parts.page.files import assets
from companion.parts.page.link import certify
from companion.parts.page.messages import PageRequest, request_in
from companion.parts.page.recordings import recordings_in
from companion.settings.links import HttpSettings
from estimator.contracts.commands import Hover, Velocity
from estimator.contracts.errors import BadInput
from tests.fly import record_to
from tests.make import seen
from tests.support.page_service import TOKEN, PageService, browsing, serving
from tests.support.waiting import PATIENCE_S, until


async def test_a_browser_watches_and_gives_orders_through_the_arbiter(tmp_path: Path) -> None:
    async with serving(tmp_path) as service, browsing(service) as browser:
        welcome = await browser.read("welcome")
        assert welcome["camera_px"] == [640, 360]
        state = await browser.read("state")
        assert state["battery_fraction"] == 0.5
        assert state["refusals"]["takeoff"] == "the vehicle flies already"
        assert state["refusals"]["land"] is None
        assert (await browser.order("hold"))["accepted"]
        assert service.pilot.paused
        refused = await browser.order("takeoff")
        assert (refused["accepted"], refused["text"]) == (False, "refused: the vehicle flies already")
        assert (await browser.order("land"))["accepted"]
        while (state := await browser.read("state"))["phase"] != "landing where it is":
            pass
        assert isinstance(service.command, Velocity)
        assert service.command.v_level.item(2) > 0.0, "down"
        assert [str(o.sender) for o in service.orders] == [welcome["you"]] * 3
        await browser.read("state")
        assert any("Hold: accepted" in message.get("text", "") for message in browser.messages if message["kind"] == "event")
        assert "an order of MQTT" in (await browser.order("record"))["text"]
        for order, accepted in (("land", False), ("hold", True), ("emergency", True)):
            await browser.send(kind="order", number=9, order=order, seen_at_s=state["at_s"] - 3.5)
            assert (await browser.read("answer"))["accepted"] is accepted, "what was long on its way, and stops nothing"


async def test_no_state_overtakes_the_welcome_and_what_happened_before(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    serve = viewer.PageViewer.serve
    async with serving(tmp_path) as service:

        def serve_late(one: viewer.PageViewer, take: Callable[[PageRequest], str | None]) -> Coroutine[None, None, None]:
            service.page._tell_states()
            return serve(one, take)

        monkeypatch.setattr(viewer.PageViewer, "serve", serve_late)
        async with browsing(service) as browser:
            await browser.order("hold")
        async with browsing(service) as browser:
            await browser.read("state")
            kinds = [message["kind"] for message in browser.messages]
            assert kinds[0] == "welcome"
            assert {"event", "health"} <= set(kinds[: kinds.index("state")])


async def test_things_are_shown_while_frames_are_searched(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(endpoint, "_THINGS_S", 0.2)
    async with serving(tmp_path) as service, browsing(service) as browser:
        service.found = seen(service.clock.now(), True).detection
        while (state := await browser.read("state"))["things"] == []:
            pass
        assert state["things"][0]["width_m"] == 0.25
        service.found = None
        async with asyncio.timeout(PATIENCE_S):
            while (await browser.read("state"))["things"] != []:
                pass


async def test_pictures_come_one_after_the_other_and_wait_for_the_browser(tmp_path: Path) -> None:
    async with serving(tmp_path, picture_rate_hz=60.0) as service, browsing(service) as browser:
        first = await browser.read("picture")
        image = cv2.imdecode(np.frombuffer(browser.pictures[0][1], np.uint8), cv2.IMREAD_COLOR)
        assert image.shape == (360, 640, 3)
        assert abs(int(image[0, 0, 0]) - 90) < 3
        assert first["verdict"] == "no_pad"
        before = service.cycles
        await until(lambda: service.cycles > before + 60)
        assert service.counted("page", "pictures") == viewer._IN_FLIGHT, "a browser that says nothing gets no more"
        await browser.read("picture")
        await browser.send(kind="drawn", number=browser.pictures[-1][0]["number"])
        newer = await browser.read("picture")
        assert newer["number"] > first["number"] + 1
        await until(lambda: service.page._viewers[0].picture_delay_s is not None)


async def test_a_page_on_tls_answers_nobody_in_clear_and_its_certificate_is_checked(tmp_path: Path) -> None:
    files = [tmp_path / "page.crt", tmp_path / "page.key"]
    certify("127.0.0.1", *files)
    made = files[0].read_bytes()
    certify("127.0.0.1", *files)
    assert files[0].read_bytes() == made, "a phone accepts it once"
    trusting = ssl.create_default_context(cafile=files[0])
    trusting.verify_flags &= ~ssl.VERIFY_X509_STRICT  # as with a CA of one's own
    names = dict(zip(("certificate_file", "key_file"), map(str, files), strict=True))
    async with serving(tmp_path, endpoint="https", **names) as service, aiohttp.ClientSession() as session:
        async with session.get(f"{service.address}/", ssl=trusting) as answer:
            assert answer.status == 200
        with pytest.raises(aiohttp.ClientConnectorCertificateError):
            await session.get(f"{service.address}/")
        with pytest.raises((aiohttp.ClientError, ConnectionError)):
            await session.get(service.address.replace("https", "http") + "/")
        async with session.ws_connect(f"{service.address}/operator", origin=service.address, ssl=trusting) as socket:
            await socket.send_str(json.dumps({"kind": "login", "token": TOKEN}))
            assert json.loads((await socket.receive()).data)["kind"] == "welcome"


async def test_each_browser_gets_the_pictures_that_it_can_decode(tmp_path: Path) -> None:
    async with serving(tmp_path, picture_rate_hz=60.0) as service, browsing(service) as old, browsing(service) as new:
        assert (await new.read("welcome"))["h264"]
        await new.send(kind="picture", codec="h264")
        decoder = av.CodecContext.create("h264", "r")
        units: list[tuple[str, bytes]] = []
        while len(units) < 6:
            header = await new.read("picture")
            await new.send(kind="drawn", number=header["number"])
            if header["codec"] != "jpeg":
                units.append((header["codec"], new.pictures[-1][1]))
        assert re.fullmatch("avc1.42[0-9a-f]{4}", units[0][0]), "baseline, which every browser decodes"
        assert [codec for codec, _ in units[1:]] == [""] * 5
        assert sum(len(unit) for _, unit in units[1:]) < len(units[0][1]), "only what changes is sent"
        shown = [frame.to_ndarray(format="bgr24") for _, unit in units for frame in decoder.decode(av.Packet(unit))]
        shown += [frame.to_ndarray(format="bgr24") for frame in decoder.decode(None)]
        assert len(shown) == 6
        assert np.abs(shown[-1].astype(int) - 90).max() < 6
        assert (await old.read("picture"))["codec"] == "jpeg"
        # Its decoder has failed with both pictures on their way: it begins again, and nothing waits for them.
        await until(lambda: not service.page._viewers[1].ready)
        await new.send(kind="picture", codec="h264")
        while (await new.read("picture"))["codec"] in ("", "jpeg"):
            pass


async def test_a_camera_of_odd_size_is_shown_as_jpeg(tmp_path: Path) -> None:
    async with serving(tmp_path, picture_rate_hz=60.0) as service, browsing(service) as browser:
        service.px = np.full((361, 641, 3), 90, np.uint8)
        await browser.send(kind="picture", codec="h264")
        for _ in range(4):
            header = await browser.read("picture")
            await browser.send(kind="drawn", number=header["number"])
        image = cv2.imdecode(np.frombuffer(browser.pictures[-1][1], np.uint8), cv2.IMREAD_COLOR)
        assert (header["codec"], image.shape) == ("jpeg", (361, 641, 3))
    async with serving(tmp_path, picture_codec="jpeg") as service, browsing(service) as browser:
        assert not (await browser.read("welcome"))["h264"]
        await browser.send(kind="picture", codec="h264")
        assert (await browser.read("picture"))["codec"] == "jpeg"


async def test_a_browser_that_has_the_hand_and_goes_leads_to_a_hold(tmp_path: Path) -> None:
    async with serving(tmp_path) as service:
        async with browsing(service) as browser:
            assert (await browser.order("manual"))["accepted"]
            await browser.send(kind="sticks", forward=1.0)
            await until(lambda: isinstance(service.command, Velocity))
        await until(lambda: isinstance(service.command, Hover))
        assert service.pilot.paused
        assert service.orders[-1].detail == "(its page closed)"


@pytest.mark.hazard("H11")
async def test_losing_every_page_changes_nothing_of_a_landing_under_way(tmp_path: Path) -> None:
    async with serving(tmp_path) as service:
        async with browsing(service) as browser, browsing(service) as other:
            await other.read("welcome")
            assert (await browser.order("begin"))["accepted"]
            state = service.pilot.state
        await until(lambda: service.server.viewers == 0)
        assert (service.pilot.state, service.pilot.paused) == (state, False)
        assert [order.order.value for order in service.orders] == ["begin"]


async def test_two_operators_see_each_other_s_orders_and_one_has_the_hand_over_its_connections(tmp_path: Path) -> None:
    async with serving(tmp_path) as service, browsing(service, page="3-1-4") as one, browsing(service) as two:
        me = (await one.read("welcome"))["you"]
        await two.read("welcome")
        other = f"another page {me[me.index('(') :]}"
        assert (await one.order("manual"))["accepted"]
        await one.send(kind="sticks", forward=0.5)
        refusal = f'{other} has the hand; "Fly by hand" takes it while its sticks rest'
        assert (await two.order("begin"))["text"] == f"refused: {refusal}"
        assert (state := await two.read("state"))["hand"] == other
        assert state["refusals"]["begin"] == refusal
        assert [m["text"] for b in (one, two) for m in b.messages if m["kind"] == "event" and "Fly by hand" in m["text"]]
        async with browsing(service, page="3-1-4") as again:
            assert (await again.read("welcome"))["you"] == me
        await until(lambda: service.server.viewers == 2)
        assert "(its page closed)" not in [order.detail for order in service.orders]
        assert (await two.order("emergency"))["accepted"]
        while "Cut the motors: accepted" not in (await one.read("event"))["text"]:
            pass


@pytest.mark.hazard("H9")
async def test_an_event_says_what_a_person_can_do_about_it(tmp_path: Path) -> None:
    async with serving(tmp_path) as service, browsing(service) as browser:
        await browser.read("welcome")
        now = service.clock.now()
        wind = Reason(ReasonCause.WIND, 12.0, 10.0)
        changes = (
            StateChange(now, State.GATE, Event.NO_CONDITIONS, State.GO_AROUND, wind),
            StateChange(now, State.STANDBY, Event.TAKEN_OFF, State.READY, Reason(ReasonCause.VEHICLE_FLIES)),
        )
        service.page.on_decision(Decision(now, "go around", None, None, transitions=changes))
        around = await browser.read("event")
        while not around["text"].startswith("going around"):
            around = await browser.read("event")
        assert (around["level"], around["advice"]) == ("warning", "Wait for less wind, or let the ship run with it.")
        assert (await browser.read("event"))["advice"] == ""
        while not (await browser.read("state"))["advice"]:
            service.page.on_decision(Decision(now, "go around", None, None, transitions=changes[:1]))
            service.page._tell_states()
        while (await browser.read("state"))["advice"]:
            pass  # the state that the pilot is in meanwhile needs no advice


async def refused_with(service: PageService, token: str) -> None:
    async with browsing(service, token) as browser:
        await browser.send(kind="order", number=1, order="emergency")
        assert (await browser.read("refused"))["text"] == "the token is wrong"
        assert (await browser.read("closed"))["code"] == 4401
        assert [message["kind"] for message in browser.messages] == ["refused"]


@pytest.mark.hazard("H8")
async def test_without_the_token_nothing_is_reported_and_nothing_is_obeyed(tmp_path: Path) -> None:
    async with serving(tmp_path) as service:
        tokens = ("", "another-token-of-sixteen", TOKEN[:-1], TOKEN + "x")
        await asyncio.gather(*(refused_with(service, token) for token in tokens))
        assert service.orders == []
        assert service.server.counts["wrong_tokens"] == 4
        async with browsing(service) as browser:
            await browser.read("welcome")


@pytest.mark.parametrize("origin", ["http://evil.example", "null", "http://127.0.0.1:1", "https://localhost"])
async def test_another_page_cannot_open_the_connection(tmp_path: Path, origin: str) -> None:
    async with serving(tmp_path) as service:
        with pytest.raises(aiohttp.WSServerHandshakeError) as refused:
            async with browsing(service, origin=origin):
                pass
        assert refused.value.status == 403
        async with aiohttp.ClientSession() as session:
            with pytest.raises(aiohttp.WSServerHandshakeError):
                await session.ws_connect(f"{service.address}/operator")


async def test_every_answer_has_strict_headers_and_no_path_leads_out(tmp_path: Path) -> None:
    async with serving(tmp_path) as service, aiohttp.ClientSession(service.address) as client:
        async with client.get("/") as answer:
            page, policy = await answer.text(), answer.headers["Content-Security-Policy"]
            assert "default-src 'none'" in policy
            assert "unsafe" not in policy
            assert answer.headers["Server"] == "decklander"
            assert "Set-Cookie" not in answer.headers
        assert not re.search(r'(src|href)="https?:|style="|onclick=|<style', page), "nothing of another host, nothing inline"
        named = re.findall(r'(?:src|href)="([^#"]+)"', page)
        assert named
        assert not any(name.startswith("/") for name in named), "a proxy may serve the page under a path"
        assert {f"/{name}" for name in named} < set(assets())
        for path in assets():
            async with client.get(path) as answer:
                assert answer.status == 200
                assert not re.search(rb"https?://(?!www\.w3\.org/)|[`\"']/\w|host\}/", await answer.read())
        for path in ("/../settings.py", "/%2e%2e/settings.py", "/static/index.html", "/operator/", "/token"):
            async with client.get(path) as answer:
                assert answer.status == 404
                assert answer.headers["X-Content-Type-Options"] == "nosniff"
        async with client.get("/operator", headers={"Origin": service.address}) as answer:
            assert answer.status == 426
        async with client.post("/", data=b"x" * 100) as answer:
            assert answer.status == 405


async def test_what_a_browser_keeps_of_other_services_does_not_judge_this_one(tmp_path: Path) -> None:
    """Cookies hold for all ports of a host's name; a proxy adds headers of its own."""
    long = "; ".join(f"state_{n}={'x' * 4000}" for n in range(12))
    async with serving(tmp_path) as service, aiohttp.ClientSession(service.address) as client:
        for cookie in ("user=Ren\u00e9; lang=no", "broken=\xff\xfe;;=;", long):
            headers = {
                "Cookie": cookie,
                "Origin": service.address,
                "X-Forwarded-For": "b\u00e5t",
                "Accept-Encoding": "br;q=1, zstd",
            }
            async with client.get("/", headers=headers) as answer:
                assert answer.status == 200
            socket = await client.ws_connect("/operator", headers=headers)
            await socket.close()


async def test_garbage_a_flood_and_a_huge_message_end_their_own_connection_alone(tmp_path: Path) -> None:
    async with serving(tmp_path) as service, browsing(service) as other:
        order = '{"kind":"order","number":-1,"order":"land"}'
        for said in ("{}", '{"kind":"sticks","forward":2.0}', '{"kind":"login","token":"again"}', order, "x" * 70_000):
            async with browsing(service) as browser:
                await browser.read("welcome")
                await browser.socket.send_str(said)
                assert (await browser.read("closed"))["code"] in ((1006, 1009) if len(said) > 60_000 else (4400,))
        async with browsing(service) as browser:
            for _ in range(150):
                await browser.send(kind="sticks")
            assert (await browser.read("closed"))["code"] == 4400
        before = service.cycles
        assert (await other.order("hold"))["accepted"]
        await until(lambda: service.cycles > before + 5)


async def test_a_flood_of_connections_neither_grows_nor_touches_who_is_logged_in(tmp_path: Path) -> None:
    limits = ConnectionLimits(connections=8, connection_s=0.4)
    async with serving(tmp_path, limits) as service, browsing(service) as browser:
        await browser.read("welcome")
        opened = [await asyncio.open_connection("127.0.0.1", service.server.port) for _ in range(60)]
        for _, writer in opened:
            writer.write(b"GET /operator HTTP/1.1\r\nHost: x\r\n")
        await until(lambda: not limits.open)
        assert limits.evicted + limits.overdue >= 60
        assert (await browser.order("hold"))["accepted"]
        for _, writer in opened:
            writer.close()


async def test_no_more_browsers_than_the_settings_allow(tmp_path: Path) -> None:
    async with serving(tmp_path, viewers_max=1) as service, browsing(service) as browser:
        await browser.read("welcome")
        async with browsing(service) as second:
            assert (await second.read("refused"))["text"] == "1 watch already, and there may be no more"
            assert (await second.read("closed"))["code"] == 4409
        assert (await browser.order("hold"))["accepted"]


async def test_a_silent_connection_must_send_its_token_in_time(tmp_path: Path) -> None:
    limits = ConnectionLimits(connection_s=0.3)
    async with serving(tmp_path, limits) as service, aiohttp.ClientSession() as session:
        socket = await session.ws_connect(f"{service.address}/operator", origin=service.address)
        async with asyncio.timeout(PATIENCE_S):
            assert (await socket.receive()).type in (aiohttp.WSMsgType.CLOSED, aiohttp.WSMsgType.CLOSE)
        assert limits.overdue == 1


def test_settings_that_would_give_the_token_away_are_refused() -> None:
    for options, why in (
        ({"endpoint": "http"}, "token_file is needed"),
        ({"endpoint": "http", "page": False, "host": "deck.local"}, r"token_file is needed because host \(deck.local\)"),
        ({"endpoint": "http", "token_file": "t", "host": "0.0.0.0"}, 'endpoint must be "https"'),
        ({"endpoint": "https", "token_file": "t"}, "certificate_file and key_file are needed"),
    ):
        with pytest.raises(ValueError, match=why):
            HttpSettings(**options)
    for host in ("127.0.0.1", "127.8.0.1", "::1", "localhost"):
        HttpSettings(endpoint="http", host=host, page=False)
    HttpSettings(endpoint="http", host="0.0.0.0", page=False, token_file="t")


def test_a_token_that_is_missing_or_short_keeps_the_service_from_beginning(tmp_path: Path) -> None:
    with pytest.raises(BadInput, match="token_file"):
        PageService(tmp_path, token_file=str(tmp_path / "none"))
    (tmp_path / "short").write_text("abc")
    with pytest.raises(BadInput, match="16 or more"):
        PageService(tmp_path, token_file=str(tmp_path / "short"))


@given(st.text(max_size=80))
def test_no_text_makes_the_decoder_raise(text: str) -> None:
    assert request_in(text) is not None


async def test_a_recording_is_loaded_once_from_an_address_that_only_the_page_gets(tmp_path: Path) -> None:
    (tmp_path / "recordings").mkdir()
    content = bytes(range(256)) * 1024
    (tmp_path / "recordings/decklander-1.mcap").write_bytes(content)
    (tmp_path / "recordings/notes.txt").write_text("not a recording")
    (tmp_path / "recordings/link.mcap").symlink_to(tmp_path / "token")
    async with serving(tmp_path) as service, browsing(service) as browser, aiohttp.ClientSession(service.address) as client:
        await browser.send(kind="recordings")
        listed = await browser.read("recordings")
        assert [(file["name"], file["size_bytes"]) for file in listed["files"]] == [("decklander-1.mcap", len(content))]
        await browser.send(kind="download", name="decklander-1.mcap")
        assert "the vehicle flies" in (await browser.read("download"))["text"]
        await service.lands()
        await browser.send(kind="download", name="decklander-1.mcap")
        address = (await browser.read("download"))["address"]
        async with client.get(address) as answer:
            assert answer.headers["Content-Disposition"] == 'attachment; filename="decklander-1.mcap"'
            assert await answer.read() == content
        async with client.get(address) as answer:
            assert answer.status == 404, "an address holds once"
        for name in ("../token", "/etc/passwd", "notes.txt", ".mcap"):
            await browser.send(kind="download", name=name)
            assert (await browser.read("download"))["address"] is None
        for name in ("link.mcap", "decklander-2.mcap"):
            await browser.send(kind="download", name=name)
            async with client.get((await browser.read("download"))["address"]) as answer:
                assert answer.status == 404, "no link is followed, and nothing made up"
        async with client.get("/recordings/AAAAAAAAAAAAAAAA") as answer:
            assert answer.status == 404


def test_a_recording_that_is_removed_while_the_list_is_made_hides_no_other(tmp_path, monkeypatch):
    for number in (1, 2):
        (tmp_path / f"decklander-{number}.mcap").touch()
    real = Path.lstat

    def lstat(path: Path) -> os.stat_result:
        if path.name == "decklander-1.mcap":
            path.unlink()
        return real(path)

    monkeypatch.setattr(Path, "lstat", lstat)
    listed = recordings_in(tmp_path)
    assert ([file.name for file in listed.files], listed.fault) == (["decklander-2.mcap"], "")


def reports_in(folder: Path) -> list[Path]:
    return list(folder.glob("decklander-reports-*/*.html"))


async def test_a_report_is_made_on_the_ground_and_opened_in_a_sandbox(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    (tmp_path / "recordings").mkdir()
    record_to(tmp_path / "recordings/decklander-1.mcap", 0.5)
    (tmp_path / "recordings/torn.mcap").write_bytes(b"no recording")
    async with serving(tmp_path) as service, browsing(service) as browser, aiohttp.ClientSession(service.address) as client:
        await browser.send(kind="report", name="decklander-1.mcap")
        assert "the vehicle flies" in (await browser.read("report"))["text"]
        await service.lands()
        await browser.send(kind="report", name="decklander-1.mcap")
        assert (await browser.read("report"))["text"] == "is being made"
        made = await browser.read("report")
        assert made["text"] == ""
        async with client.get(made["address"]) as answer:
            assert "sandbox allow-scripts" in answer.headers["Content-Security-Policy"]
            assert answer.headers["Referrer-Policy"] == "no-referrer"
            assert "decklander-1" in await answer.text()
        for name, why in (("torn.mcap", "torn.mcap"), ("none.mcap", "No such file")):
            await browser.send(kind="report", name=name)
            await browser.read("report")
            refused = await browser.read("report")
            assert refused["address"] is None
            assert why in refused["text"]
        await browser.send(kind="report", name="../token")
        assert "no recording's name" in (await browser.read("report"))["text"]
        await browser.send(kind="report", name="decklander-1.mcap")
        await browser.read("report")
        service.flying = True
        assert "the vehicle flies" in (await browser.read("report"))["text"], "a take-off ends the work"
        assert len(reports_in(tmp_path)) == 1
    assert reports_in(tmp_path) == []
