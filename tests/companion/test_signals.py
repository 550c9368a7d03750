"""Told to end, the process ends, whatever its tasks, its threads and its main thread are doing.

It never ends by an exception through the event loop. Two seconds are requested. Here the bound
is any test's patience: what these programs would do without the deadline takes an hour or never ends.
"""

import asyncio
import signal
import subprocess
import sys
import time

import pytest

from companion.base import event_loop
from tests.support.processes import burners, decklander, python, started
from tests.support.waiting import PATIENCE_S, free_port

HEAD = """
import asyncio, contextlib, hashlib, os, signal, sys, threading, time
from companion.base import signals
from companion.base.event_loop import heeded, run

def say(*words): print(*words, flush=True)
def program(work):
    signals.install()
    try:
        code = work() or 0
    except signals.Stopped as why:
        code = why.exit_code
    sys.exit(signals.leave(code))
"""


def line(process: subprocess.Popen[str]) -> str:
    return process.stdout.readline().strip()


def ended(process: subprocess.Popen[str], *numbers: int, pause_s: float = 0.4) -> tuple[int, list[str]]:
    """Signals one after the other; its exit code and what it still said."""
    for n, number in enumerate(numbers):
        if n:
            time.sleep(pause_s)
        process.send_signal(number)
    out, err = process.communicate(timeout=PATIENCE_S)
    return process.returncode, [*out.splitlines(), *(err or "").splitlines()]


STUBBORN = """
async def stubborn():
    while True:
        with contextlib.suppress(asyncio.CancelledError):
            await asyncio.sleep(3600)
async def main():
    async with asyncio.TaskGroup() as group:
        group.create_task(stubborn(), name="stubborn")
        await asyncio.sleep(0)
        say("ready")
program(lambda: run(main()))
"""
BUSY = {
    "a thread of the default executor": """
async def main():
    thread = asyncio.create_task(asyncio.to_thread(time.sleep, 3600))
    await asyncio.sleep(0.1)
    say("ready")
    await thread
program(lambda: run(main()))
""",
    "vision's thread": """
from companion.base.worker import Worker
async def main():
    call = Worker("eyes").run(hashlib.pbkdf2_hmac, "sha256", b"", b"", 10**9)
    await asyncio.sleep(0.1)
    say("ready")
    await call
program(lambda: run(main()))
""",
    "any thread that Python would join": """
def work():
    threading.Thread(target=time.sleep, args=(3600,)).start()
    say("ready")
    while True:
        sum(range(10000))
program(work)
""",
}
HELD = {
    "the event loop's thread inside a library": """
async def main():
    threading.Timer(0.3, say, ("ready",)).start()  # from another thread: this one is inside the library by then
    hashlib.pbkdf2_hmac("sha256", b"", b"", 10**9)
program(lambda: run(main()))
""",
    "code that carries on after everything": """
def work():
    while True:
        try:
            say("ready")
            time.sleep(3600)
        except BaseException:
            pass
program(work)
""",
}


def test_a_program_that_asked_for_more_time_writes_what_would_be_lost() -> None:
    writing = """
async def main():
    try:
        say("ready")
        await asyncio.sleep(3600)
    except asyncio.CancelledError:
        time.sleep(signals.LAST_S + 0.5)
        await asyncio.sleep(0.1)
        say("written")
def work():
    with signals.more_time(600.0):
        run(main())
    signals.check()
program(work)
"""
    with python(HEAD + writing, stderr=subprocess.PIPE) as process:
        assert line(process) == "ready"
        assert ended(process, signal.SIGTERM) == (128 + signal.SIGTERM, ["written"])


def test_a_task_that_does_not_end_is_named_and_abandoned() -> None:
    with python(HEAD + STUBBORN, stderr=subprocess.PIPE) as process:
        assert line(process) == "ready"
        code, output = ended(process, signal.SIGTERM)
    assert code == 143
    # A loop without processor time for two seconds has none to name its task either: the thread that ends it says so.
    assert any(("stubborn" in words and "going without" in words) or "ending at once" in words for words in output)
    assert not any("Traceback" in words for words in output)


@pytest.mark.parametrize("what", sorted(BUSY))
def test_a_busy_thread_holds_nothing_up(what: str) -> None:
    with python(HEAD + BUSY[what], stderr=subprocess.PIPE) as process:
        assert line(process) == "ready"
        assert ended(process, signal.SIGTERM) == (143, [])


@pytest.mark.parametrize("what", sorted(HELD))
def test_what_holds_the_main_thread_is_named_and_the_process_ends_around_it(what: str) -> None:
    with python(HEAD + HELD[what], stderr=subprocess.PIPE) as process:
        assert line(process) == "ready"
        code, output = ended(process, signal.SIGTERM)
    assert code == 143
    assert "ending at once" in output[-1]
    assert "main thread in" in output[-1]


def test_standard_error_that_nobody_reads_holds_nothing_up() -> None:
    full = (
        "def work():\n    os.set_blocking(2, True)\n    say('ready')\n    while True: os.write(2, b'x' * 4096)\nprogram(work)\n"
    )
    with python(HEAD + full, stderr=subprocess.PIPE) as process:
        assert line(process) == "ready"
        time.sleep(0.2)
        process.send_signal(signal.SIGTERM)
        assert process.wait(PATIENCE_S) == 143


AFTER_EXIT = """
async def part():
    sys.exit(0)
async def main():
    loop = asyncio.get_running_loop()
    loop.set_exception_handler(lambda _, context: say("LOOP", context))
    part_of_it = asyncio.create_task(part())
    loop.call_soon(sys.exit, 3)
    await asyncio.sleep(0.05)
    say("ready")
    try:
        await asyncio.Event().wait()
    finally:
        loop.call_soon(sys.exit, 4)
        await asyncio.sleep(0.01)
        say("hovered")
program(lambda: run(main()))
"""


def test_signals_end_it_in_order_though_its_tasks_and_callbacks_call_exit() -> None:
    with python(HEAD + AFTER_EXIT, stderr=subprocess.PIPE) as process:
        assert line(process) == "ready"
        code, output = ended(process, signal.SIGINT)
        assert (code, output[0]) == (130, "hovered")


HEEDING = """
async def main():
    end = asyncio.Event()
    with heeded({signal.SIGTERM: end.set, signal.SIGINT: end.set, signal.SIGUSR1: lambda: say("begun")}):
        say("ready")
        await end.wait()
    await asyncio.sleep(float(sys.argv[1]))
    say("done")
    return 0
program(lambda: run(main()))
"""


@pytest.mark.parametrize(
    ("seconds", "numbers", "pause_s", "code", "output"),
    [
        ("0.01", (signal.SIGTERM,), 0.0, 0, ["done"]),
        ("2.5", (signal.SIGINT,), 0.0, 0, ["done"]),
        ("3600", (signal.SIGTERM,), 0.0, 143, None),
        ("3600", (signal.SIGINT, signal.SIGTERM), 0.4, 143, []),
        ("0.3", (signal.SIGINT, signal.SIGINT), 0.0, 0, ["done"]),
    ],
    ids=["heeded", "time after ctrl-c", "none after SIGTERM", "second", "a copy by two ways"],
)
def test_a_signal_that_is_heeded_ends_the_program_its_own_way_and_a_second_one_at_once(seconds, numbers, pause_s, code, output):
    with python(HEAD + HEEDING, seconds, stderr=subprocess.PIPE) as process:
        assert line(process) == "ready"
        process.send_signal(signal.SIGUSR1)
        assert line(process) == "begun"
        found = ended(process, *numbers, pause_s=pause_s)
        assert found[0] == code
        assert output is None or found[1] == output


def test_what_a_forked_worker_receives_does_not_end_its_parent() -> None:
    source = """
def work():
    child = os.fork()
    if child == 0:
        time.sleep(3600)
    os.kill(child, signal.SIGTERM)
    say("child", os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]))
    time.sleep(0.3)
    say("told", signals.ending_signal())
program(work)
"""
    with python(HEAD + source) as process:
        out, _ = process.communicate(timeout=60)
    assert process.returncode == 0
    assert out.splitlines() == ["child 143", "told None"]


@pytest.mark.parametrize(
    ("daemon", "shut_down"), [("", "shut down\n"), ("threading.Thread(target=time.sleep, args=(9,), daemon=True)", "")]
)
def test_the_interpreter_is_not_shut_down_under_a_thread_that_runs(daemon: str, shut_down: str) -> None:
    """Inside a C++ library it would abort the process."""
    start = f"{daemon}.start()" if daemon else "pass"
    source = f"import atexit\ndef work():\n    atexit.register(print, 'shut down')\n    {start}\n    return 3\nprogram(work)\n"
    with python(HEAD + source) as process:
        out, _ = process.communicate(timeout=60)
    assert process.returncode == 3
    assert out == shut_down


# The commands themselves, at any moment


@pytest.fixture(scope="module")
def rig(tmp_path_factory: pytest.TempPathFactory) -> str:
    """Return settings of a drone that is not there, with everything on that takes time to end."""
    folder = tmp_path_factory.mktemp("rig")
    port = free_port()
    file = folder / "rig.toml"
    file.write_text(f"""
[vehicle]
kind = "ardrone"
host = "127.0.0.1"
[expert.vehicle]
navdata_port = {port}
video_port = {port}
[camera]
file = "sim"
[pad]
file = "thesis"
[recorder]
enabled = true
folder = "{folder}/recordings"
[mqtt]
transport = "tcp"
host = "127.0.0.1"
port = {port}
spool = "{folder}/spool"
[bridge]
links = "udpin://127.0.0.1:0"
""")
    return str(file)


@pytest.mark.parametrize("moment_s", [0.5, None])
def test_sigterm_at_any_moment_on_a_busy_machine(moment_s: float | None, rig: str) -> None:
    """End the service at a moment, or, if none is given, while it ends already."""
    with burners(2), started(decklander("run", "--config", rig), stderr=subprocess.PIPE) as process:
        if moment_s is None:
            while "trying again" not in (words_of := process.stderr.readline()):
                assert words_of
            code, output = ended(process, signal.SIGINT, signal.SIGTERM, pause_s=0.02)
        else:
            time.sleep(moment_s)
            code, output = ended(process, signal.SIGTERM)
    assert code in (0, 143, -signal.SIGTERM)  # before anything was begun Python's own answer is as good
    assert not any("Traceback" in words for words in output), f"after {moment_s} s"


def test_semaphores_that_are_in_use_at_the_end_do_not_leak() -> None:
    """WHY: a campaign that SIGTERM ended printed Python's warning of leaked semaphores over its own last line."""
    source = """
from multiprocessing import get_context
def work():
    work.kept = get_context("forkserver").Queue()
    say("ready")
    time.sleep(3600)
program(work)
"""
    with python(HEAD + source, stderr=subprocess.PIPE) as process:
        assert line(process) == "ready"
        assert ended(process, signal.SIGTERM) == (143, [])


WHILE_A_CLASS_IS_MADE = """
class Named:
    def __set_name__(self, owner, name):
        os.kill(os.getpid(), signal.SIGTERM)
def run(argv, load):
    class Owner:
        field = Named()
    return 0
main._run = run
"""
WHILE_IT_IS_INSTALLED = """
class Late(threading.Thread):
    def start(self):
        os.kill(os.getpid(), signal.SIGTERM)
        super().start()
signals.threading.Thread = Late
"""


@pytest.mark.parametrize("moment", [WHILE_A_CLASS_IS_MADE, WHILE_IT_IS_INSTALLED], ids=["class", "install"])
def test_sigterm_before_anything_was_begun_is_an_end_and_no_error(moment: str) -> None:
    """Python wraps what is raised while it makes a class, and a handler raises while the next one is installed."""
    first = "import os, signal, sys, threading\nfrom companion.cli import main\nfrom companion.base import signals\n"
    last = "sys.argv = ['decklander', 'pad', 'list']\nsys.exit(main.main())\n"
    ended = subprocess.run([sys.executable, "-c", first + moment + last], capture_output=True, text=True, timeout=60, check=False)
    assert (ended.returncode, ended.stderr) == (143, "")


def test_timers_that_are_due_within_two_milliseconds_run_at_one_wake_up() -> None:
    order: list[str] = []

    async def note(name: str, in_s: float) -> None:
        for _ in range(2):
            await asyncio.sleep(in_s)
            order.append(name)
            in_s = 0.0

    async def main() -> None:
        await asyncio.gather(note("one", 0.01), note("another", 0.0115))

    event_loop.run(main())
    assert order == ["one", "another", "one", "another"]
