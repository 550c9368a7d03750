"""Render frames in a second process while the flight goes on. The frames have the same bits as without it."""

import multiprocessing
import os
import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from multiprocessing.connection import Connection
from multiprocessing.sharedctypes import RawArray
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from sitl.camera.camera import Exposure, Renderer
from sitl.camera.film import Film

U8 = NDArray[np.uint8]
Order = tuple[int, Exposure, np.random.Generator]
"""A request: number of the frame slot, scene, state of the random generator."""
_SHELVES = 16
"""Number of frames that may be in progress, half a second's worth."""
_END_S = 5.0  # time that a worker gets to end


class RenderWorker:
    """Sends requests to the render process and receives frames from it; see `render_worker`."""

    def __init__(self, orders: Connection, frame_slots: NDArray[np.uint8]) -> None:
        self._orders = orders
        self._frame_slots = frame_slots
        self._ordered = self._made = 0
        self._kept: dict[int, U8] = {}

    def order(self, shot: Exposure, rng: np.random.Generator) -> Callable[[], U8]:
        """Begin a frame, and return a function that waits for it."""
        number = self._ordered
        if number - self._made >= len(self._frame_slots):
            self._receive()
        self._orders.send((number % len(self._frame_slots), shot, rng))
        self._ordered += 1
        return lambda: self._image(number)

    def _image(self, number: int) -> U8:
        while self._made <= number:
            self._receive()
        return self._kept.pop(number)

    def _receive(self) -> None:
        try:
            self._orders.recv()
        except (EOFError, OSError) as why:
            raise RuntimeError("the process that renders has ended") from why
        self._kept[self._made] = self._frame_slots[self._made % len(self._frame_slots)].copy()
        self._made += 1


@contextmanager
def render_worker(renderer: Renderer | Film) -> Iterator[RenderWorker | None]:
    """Provide a render process until the context ends, or None if this machine has a single processor or cannot fork."""
    if len(os.sched_getaffinity(0)) < 2 or "fork" not in multiprocessing.get_all_start_methods():
        yield None
        return
    context = multiprocessing.get_context("fork")
    shape = (_SHELVES, renderer.camera.height, renderer.camera.width, 3)
    memory = RawArray("B", int(np.prod(shape)))
    frame_slots = np.frombuffer(memory, np.uint8).reshape(shape)
    ours, theirs = context.Pipe()
    worker = context.Process(target=_work, args=(renderer, theirs, ours, frame_slots), name="darkroom", daemon=True)
    worker.start()
    theirs.close()
    try:
        yield RenderWorker(ours, frame_slots)
    finally:
        ours.close()
        worker.join(_END_S)
        if worker.is_alive():
            worker.kill()


def _work(renderer: Renderer | Film, orders: Any, not_ours: Any, frame_slots: NDArray[np.uint8]) -> None:
    os.setpgid(0, 0)  # Ctrl-C is for the process that it renders for, and so is an interrupt of both by their name
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    not_ours.close()  # or the end of the other side would never be noticed
    cv2.setNumThreads(1)
    try:
        while True:
            storage_policy, shot, rng = orders.recv()
            frame_slots[storage_policy] = renderer.render(shot, rng)
            orders.send(storage_policy)
    except (EOFError, OSError):
        return  # the other side has ended
