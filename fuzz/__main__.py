"""Run all targets in turn and split the time between them: `python -m fuzz --seconds 60`, or `make fuzz HOURS=8`.

Prints what each executed, the code it reached and what broke, and exits with 1 when anything did. The corpus grows in `.fuzz/`
from run to run; crashers are kept in `.fuzz/crashes`. An input that is worth keeping goes to `fuzz/corpus/<target>/`, which the
test suite replays.
"""

import argparse
import os
import re
import resource
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from threading import Thread

from fuzz import native
from fuzz.target import MODULES
from supply import core

WORK = Path(".fuzz")
_PROGRESS = re.compile(r"#(\d+)\s.*\bcov: (\d+) ft: (\d+) corp: (\d+)")
_EXECUTED = re.compile(r"stat::number_of_executed_units:\s*(\d+)")
_NATIVE = re.compile(r"ERROR: (?:libFuzzer|AddressSanitizer): (.*)|(\S+: runtime error: .*)")
TARGETS = (*MODULES, native.NAME)
_SLOWEST = 6.0
"""Multiple of a time limit that the clock may show if CPU time is the measure."""
_HANG_S = 20.0
_GRACE_S = 240.0
"""Time after its limit at which a process is ended, seconds: it hangs where no alarm reaches it.

Its start, which instruments what it imports, takes more than a minute on a busy machine.
"""


@dataclass(frozen=True, slots=True)
class Result:
    """The result of one target."""

    name: str
    executions: int
    edges: int
    features: int
    corpus: int
    seconds: float
    faults: tuple[str, ...]

    def line(self) -> str:
        """One row of the table."""
        faults = f"{len(self.faults)} FAULTS" if self.faults else "-"
        counts = f"{self.executions:>10} {self.edges:>6} {self.features:>8} {self.corpus:>7}"
        return f"{self.name:<18} {counts} {self.seconds:>7.0f}  {faults}"


HEAD = f"{'target':<18} {'executions':>10} {'edges':>6} {'features':>8} {'corpus':>7} {'seconds':>7}  faults"


def run_target(name: str, seconds: float, work: Path, cpu: bool) -> Result:
    """Run one target for so long, its start included: seconds of the clock, or with `cpu` of its own CPU time.

    What is built before the start does not count: a build of the core takes a minute on a busy machine.
    """
    crashes = work / "crashes"
    longer = _SLOWEST if cpu else 1.0
    most = seconds * longer
    hang_s = round(_HANG_S * longer)
    built = native.command(work, most, hang_s) if name == native.NAME else None
    began, began_wall = time.monotonic(), time.time()
    command = built or [
        sys.executable, "-m", "fuzz.one", name, "--until", str(began + most), "--work", str(work / "corpus" / name),
        "--crashes", str(crashes), "--hang", str(hang_s),
    ]  # fmt: skip
    executions = edges = features = corpus = 0
    tail: list[str] = []
    with subprocess.Popen(command, stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, env=_environment()) as process:
        assert process.stderr is not None
        if cpu:
            Thread(target=_end_after_cpu, args=(process, seconds), daemon=True).start()
        for raw in process.stderr:
            text = raw.decode("utf-8", "replace").rstrip()
            if found := _PROGRESS.match(text):
                executions, edges, features, corpus = (int(n) for n in found.groups())
            elif found := _EXECUTED.match(text):
                executions = int(found[1])
            elif not text.startswith(("Corrupt JPEG", "Premature end")):
                tail = [*tail[-30:], text]
            if time.monotonic() - began > most + _GRACE_S:
                process.kill()
    faults = [path.read_text(encoding="utf-8").partition("\n")[0] for path in _new(crashes, f"{name}-*.txt", began_wall)]
    if process.returncode != 0:
        output = next((found[1] or found[2] for line in tail if (found := _NATIVE.search(line))), None)
        faults.append(f"{name}: {output or f'exit code {process.returncode}'}")
        crashes.mkdir(parents=True, exist_ok=True)
        (crashes / f"{name}-last-words.log").write_text("\n".join(tail) + "\n")
    return Result(name, executions, edges, features, corpus, time.monotonic() - began, tuple(faults))


def _end_after_cpu(process: subprocess.Popen[bytes], seconds: float) -> None:
    """Ask the fuzzer to end once it has used its CPU time; on SIGUSR1 it still prints its statistics."""
    ticks = os.sysconf("SC_CLK_TCK")
    while process.poll() is None:
        try:
            fields = Path(f"/proc/{process.pid}/stat").read_text().rpartition(")")[2].split()
        except OSError:
            return
        if (int(fields[11]) + int(fields[12])) / ticks >= seconds:
            process.send_signal(signal.SIGUSR1)
            return
        time.sleep(1.0)


def _environment() -> dict[str, str]:
    """Return the environment, with one thread for numpy and OpenCV: targets that compete for the cores are slower than one."""
    return {**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "PYTHONDONTWRITEBYTECODE": "1"}


def _new(folder: Path, pattern: str, since: float) -> Iterator[Path]:
    return (path for path in sorted(folder.glob(pattern)) if path.stat().st_mtime >= since - 1.0)


def run(names: Sequence[str], seconds: float, jobs: int, work: Path, cpu: bool = False) -> int:
    """Run every target, `jobs` at a time, and return the exit code."""
    each = seconds * min(jobs, len(names)) / len(names)
    print(f"{len(names)} targets, {each:.0f} s {'of CPU ' if cpu else ''}each, {jobs} at a time\n{HEAD}", flush=True)
    results = []
    with ThreadPoolExecutor(jobs) as pool:
        for result in pool.map(lambda name: run_target(name, each, work, cpu), names):
            print(result.line(), flush=True)
            results.append(result)
    faults = [fault for result in results for fault in result.faults]
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    total, edges = sum(r.executions for r in results), sum(r.edges for r in results)
    print(f"{total} executions, {edges} edges, {len(faults)} faults, {used.ru_utime + used.ru_stime:.0f} s of CPU")
    for fault in faults:
        print(f"  {fault}")
    if faults:
        print(f"inputs and tracebacks: {work / 'crashes'}")
    return 1 if faults or not all(r.executions for r in results) else 0


def main() -> int:
    """Run the command."""
    parser = argparse.ArgumentParser(prog="python -m fuzz", description="Fuzz every parser, the time split between them.")
    parser.add_argument("--seconds", type=float, default=0.0)
    parser.add_argument("--hours", type=float, default=0.0)
    parser.add_argument("--cpu", action="store_true", help="count CPU time instead, for a busy machine")
    parser.add_argument("--jobs", type=int, default=min(2, os.cpu_count() or 1))
    parser.add_argument("--only", nargs="+", choices=sorted(TARGETS), metavar="TARGET", help=f"of {', '.join(TARGETS)}")
    parser.add_argument("--work", type=Path, default=WORK)
    args = parser.parse_args()
    seconds = args.seconds + 3600.0 * args.hours
    names = args.only or list(TARGETS)
    if native.NAME in names and native.missing():
        print(native.NO_CLANG, file=sys.stderr)
        if args.only:
            return 2
        names.remove(native.NAME)
    try:
        return run(names, seconds or 60.0, max(1, args.jobs), args.work, args.cpu)
    except core.BuildError as why:
        print(why, file=sys.stderr)
        return 2


if __name__ == "__main__":
    sys.exit(main())
