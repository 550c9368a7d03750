"""The picture for a ground station: what arrives by RTP, what is drawn on it, and what a broken network costs."""

import asyncio
import socket
import threading
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path

import av
import numpy as np
import pytest
from numpy.typing import NDArray

from companion.base.observer import ProcessedFrame
from companion.guidance.pilot import make_pilot
from companion.parts.video.part import RtpStream, VideoStreamPart
from companion.settings.links import VideoStreamOptions
from companion.settings.load import load
from estimator.contracts.errors import Recoverable
from estimator.contracts.estimates import Verdict
from estimator.contracts.samples import Frame
from estimator.contracts.time import MonoNs, Stamp
from tests.make import seen
from tests.support.clocks import SteppedClock

HOST = "127.0.0.1"
SIZE = 640, 360
RATE_HZ = 15.0
S = 1_000_000_000


@pytest.fixture
def station() -> Iterator[socket.socket]:
    """Yield the socket of a ground station, with room for a whole test."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 22)
        sock.bind((HOST, 0))
        sock.settimeout(0.5)
        yield sock


def address(sock: socket.socket) -> str:
    return f"{HOST}:{sock.getsockname()[1]}"


@pytest.fixture
def closed_port(station: socket.socket) -> int:
    """Return a port on which nobody listens."""
    port = int(station.getsockname()[1])
    station.close()
    return port


def stripes(step: int) -> NDArray[np.uint8]:
    """Orange to the left, blue to the right, the border between them at 40 px a step."""
    image = np.full((SIZE[1], SIZE[0], 3), (200, 90, 30), np.uint8)
    image[:, : 40 * (step + 1)] = (30, 120, 220)
    return image


def watch_stream(port: int, folder: Path, pictures: int, begun: threading.Event, into: list[NDArray[np.uint8]]) -> None:
    """Watch as a ground station does: a session description, and FFmpeg's own receiver."""
    file = folder / "stream.sdp"
    file.write_text(
        f"v=0\no=- 0 0 IN IP4 {HOST}\ns=test\nc=IN IP4 {HOST}\nt=0 0\nm=video {port} RTP/AVP 96\na=rtpmap:96 H264/90000\n"
    )
    begun.set()
    options = {"protocol_whitelist": "file,udp,rtp", "fflags": "nobuffer", "analyzeduration": "0"}
    with av.open(str(file), options=options, timeout=20.0) as container:
        for frame in container.decode(video=0):
            into.append(frame.to_ndarray(format="bgr24"))
            if len(into) >= pictures:
                return


def test_a_receiver_that_comes_late_sees_the_pictures(closed_port: int, tmp_path: Path) -> None:
    stream = RtpStream(VideoStreamOptions(to=f"{HOST}:{closed_port}", rate_hz=RATE_HZ), SIZE)
    begun, got = threading.Event(), list[NDArray[np.uint8]]()
    receiver = threading.Thread(target=watch_stream, args=(closed_port, tmp_path, 5, begun, got), daemon=True)
    sent = 0
    for _k in range(400):
        assert stream.send(stripes(sent % 12), MonoNs(S + round(sent * S / RATE_HZ)))
        sent += 1
        if sent == 5:
            receiver.start()
            begun.wait(60.0)
        if sent > 5:
            receiver.join(0.02)
            if not receiver.is_alive():
                break
    stream.close()
    assert len(got) == 5, f"{sent} pictures were sent"
    for image in got:
        assert image.shape == (SIZE[1], SIZE[0], 3)
        left, right = image[180, 5].astype(int), image[180, -5].astype(int)
        assert left[2] > 150 > left[0], "orange, in the order of the channels"
        assert right[0] > 150 > right[2]


def test_packets_are_of_rtp_and_fit_a_radio_s_mtu(station: socket.socket) -> None:
    stream = RtpStream(VideoStreamOptions(to=address(station), rate_hz=RATE_HZ, bitrate_kbit_s=600), SIZE)
    noise = np.random.default_rng(1)
    for k in range(30):
        image = noise.integers(0, 255, (SIZE[1], SIZE[0], 3)).astype(np.uint8)
        assert stream.send(image, MonoNs(S + round(k * S / RATE_HZ)))
    assert not stream.send(stripes(0), MonoNs(S)), "a picture from before"
    stream.close()
    packets, sizes = [], []
    while True:
        try:
            data = station.recv(65536)
        except TimeoutError:
            break
        packets.append(data)
        sizes.append(len(data))
    assert max(sizes) <= 1200
    assert {data[0] >> 6 for data in packets} == {2}
    numbers = [int.from_bytes(data[2:4], "big") for data in packets]
    assert all((b - a) & 0xFFFF == 1 for a, b in pairwise(numbers))
    stamps = sorted({int.from_bytes(data[4:8], "big") for data in packets})
    assert {b - a for a, b in pairwise(stamps)} == {6000}, "90 kHz at 15 pictures a second"
    # Two seconds of pure noise, the worst that there is: the rate is kept within the buffer of one second.
    assert sum(sizes) * 8 < 3 * 600_000


def test_nobody_listening_is_no_fault_and_a_name_that_is_none_is(closed_port: int) -> None:
    stream = RtpStream(VideoStreamOptions(to=f"{HOST}:{closed_port}"), SIZE)
    for k in range(30):
        assert stream.send(stripes(k % 10), MonoNs(S + k * S // 15))
    stream.close()
    with pytest.raises(Recoverable, match=r"video_stream\.to: no\.such\.host\.invalid:5600"):
        RtpStream(VideoStreamOptions(to="no.such.host.invalid:5600"), SIZE)


@pytest.mark.parametrize("to", ["5600", "host", ":5600", "host:0", "host:70000", "host:port"])
def test_an_address_without_a_port_is_refused(to: str) -> None:
    with pytest.raises(ValueError, match="to must be ADDRESS:PORT"):
        VideoStreamOptions(to=to)


def plain_frame(number: int, at: MonoNs) -> ProcessedFrame:
    frame = Frame(Stamp(at, at, 0.001, "arrival"), number, np.full((360, 640, 3), 90, np.uint8))
    return ProcessedFrame(frame, None, None, Verdict.NO_PAD, at, at)


@pytest.mark.parametrize("drawn", [False, True])
async def test_the_part_sends_frames_at_its_rate_with_and_without_a_detection(station: socket.socket, drawn: bool) -> None:
    clock, pilot = SteppedClock(MonoNs(S)), make_pilot(load("sim"))
    part = VideoStreamPart(VideoStreamOptions(to=address(station), rate_hz=15.0, drawn=drawn), pilot, clock)
    assert not part.flows
    running = asyncio.create_task(part.run())
    for k in range(30):
        clock.t = MonoNs(S + round(k * S / 30))
        part.on_frame(plain_frame(k, clock.t) if k % 4 else seen(clock.t, found=True))
        before = part.counted()["pictures"]
        async with asyncio.timeout(60):
            while part.counted()["pictures"] == before and k % 2 == 0:  # noqa: ASYNC110 - a thread sends them
                await asyncio.sleep(0.001)
    assert part.counted() == {"pictures": 15, "pictures_skipped": 0}
    assert part.flows
    clock.t = MonoNs(clock.t + 3 * S)
    assert not part.flows
    running.cancel()
    await asyncio.gather(running, return_exceptions=True)
    assert station.recv(65536)[0] >> 6 == 2
