"""Run the service with a vehicle, a camera, a pad and a message of one's own: `python -m examples.own_parts`.

The vehicle hovers over the pad and says how it lies. The camera beside it films the pad, the service finds it, and every estimate
goes out as a JSON datagram, which is read back and printed.
"""

import asyncio
import json
import math
import socket
import sys
import tempfile
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from pathlib import Path

import numpy as np

from companion.base.containment import RESTART
from companion.base.observer import Decision, NullObserver
from companion.guidance.pilot import make_pilot
from companion.service.daemon import Daemon, DaemonSetup
from companion.service.vehicle_parts import LinkWithCamera
from companion.settings.load import camera_model, from_mapping, pad_model
from companion.settings.model import Settings
from decklander import Attitude, Imu, Rotation, Stamp
from drivers.camera.source import VideoSource
from drivers.clock import SystemClock
from drivers.mailbox import Latest, Line
from estimator.contracts.commands import Command
from estimator.contracts.motion import G_M_S2
from estimator.contracts.samples import Frame, Sample
from sitl.camera.camera import Exposure, Renderer

PAD = """
name = "dart"

[paints]
blue = [20, 60, 170]
white = [245, 245, 245]

[[regions]]
shape = "disc"
paint = "blue"
radius_m = 0.5

[[regions]]
shape = "ring"
paint = "white"
inner_m = 0.42
outer_m = 0.45

[[regions]]
shape = "polygon"
paint = "white"
points_m = [[0.36, 0.0], [0.05, 0.25], [0.05, 0.07], [-0.34, 0.07], [-0.34, -0.07], [0.05, -0.07], [0.05, -0.25]]
"""
HEIGHT_M, RATE_HZ, SIGMA_RAD = 3.0, 50.0, math.radians(0.1)
CLOCK = SystemClock()


class Kite:
    """A vehicle: samples and frames out, commands in."""

    def __init__(self) -> None:
        self.frames: Latest[Frame] = Latest()  # none: a camera is beside it
        self.samples: Line[Sample] = Line(1000)

    def command(self, command: Command) -> None:
        """Do what guidance wants, and stop when no command comes any more."""

    def release(self) -> None:
        """Leave the kite to a person."""

    async def fly(self) -> None:
        """Report attitude and IMU, each with its instant and its noise: what never changes counts as broken."""
        rng = np.random.default_rng(2)
        while True:
            now = CLOCK.now()
            stamp = Stamp(now, now, 0.001, "hw")
            self.samples.offer(Imu(stamp, rng.normal(0.0, 0.002, 3), rng.normal((0.0, 0.0, -G_M_S2), 0.02)))
            self.samples.offer(Attitude(stamp, Rotation.from_rpy(*rng.normal(0.0, SIGMA_RAD, 3)), SIGMA_RAD**2 * np.eye(3)))
            await asyncio.sleep(1.0 / RATE_HZ)


class Film(VideoSource):
    """A camera: frames with the instants of their exposures. No two have the same noise, or the camera would count as frozen."""

    def __init__(self, taken: Callable[[], np.ndarray]) -> None:
        super().__init__()
        self._taken = taken

    async def play(self) -> None:
        """Offer frames; say in `down` why there are none."""
        self.down = None
        for seq in range(10**6):
            await asyncio.sleep(0.1)
            now = CLOCK.now()
            self.frames.offer(Frame(Stamp(now, now, 0.001, "hw"), seq, self._taken()))


class Beacon(NullObserver):
    """A message out: called on the service's own thread, it must return at once."""

    def __init__(self, out: socket.socket, to: tuple[str, int]) -> None:
        self._out, self._to = out, to

    def on_decision(self, decision: Decision) -> None:
        """Send where the pad is."""
        if decision.belief is not None:
            d = [round(x, 2) for x in decision.belief.d_body_pad_level.tolist()]
            self._out.sendto(json.dumps({"phase": decision.phase, "pad_m": d}).encode(), self._to)


def settings_of(folder: Path) -> Settings:
    """Return settings with a pad of one's own."""
    (folder / "dart.toml").write_text(PAD)
    return from_mapping(
        {"vehicle": {"kind": "ardrone"}, "camera": {"file": "sim"}, "pad": {"file": str(folder / "dart.toml")}}, "own settings"
    )


async def main(settings: Settings) -> int:
    """Run until a message says where the pad is; return 1 if none does in a minute."""
    camera, pad, pilot = camera_model(settings), pad_model(settings), make_pilot(settings)
    above = Exposure(0.0, Rotation.identity(), np.array([0.0, 0.0, -HEIGHT_M]), Rotation.identity(), np.zeros(3))
    renderer, rng = Renderer(camera, pad), np.random.default_rng(1)
    film = Film(lambda: renderer.render(above, rng))

    @asynccontextmanager
    async def opened() -> AsyncIterator[LinkWithCamera]:
        kite = Kite()
        async with asyncio.TaskGroup() as group:
            tasks = [group.create_task(each) for each in (kite.fly(), film.play())]
            yield LinkWithCamera(kite, film)
            for task in tasks:
                task.cancel()

    datagrams = socket.AF_INET, socket.SOCK_DGRAM
    with socket.socket(*datagrams) as received, socket.socket(*datagrams) as sent:
        received.bind(("127.0.0.1", 0))
        received.setblocking(False)
        options = DaemonSetup(RESTART, settings.guidance.rate_hz)
        daemon = Daemon(opened, pilot, CLOCK, options, observers=[Beacon(sent, received.getsockname())])
        running = asyncio.create_task(daemon.run())
        try:
            async with asyncio.timeout(60.0):
                print((await asyncio.get_running_loop().sock_recv(received, 1000)).decode())
            return 0
        except TimeoutError:
            print("no message", dict(daemon.health.frames), file=sys.stderr)
            return 1
        finally:
            daemon.stop()
            await running


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as of_the_pad:
        sys.exit(asyncio.run(main(settings_of(Path(of_the_pad)))))
