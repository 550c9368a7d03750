"""Run one target under atheris, in its own process: `python -m fuzz.one NAME ...`, started by `python -m fuzz`.

An error that breaks the contract twice for the same input is written down and the run continues, so that the first fault does not
hide the rest. A crash in native code, a hang or too much memory ends the process; libFuzzer leaves the input beside the others.
"""

import argparse
import logging
import sys
import time
import warnings
from pathlib import Path

import atheris

from fuzz import target

ROOT = Path(__file__).parents[1]
OURS = ("companion", "drivers", "estimator", "sitl")
_OTHERS = {"mcap_bytes": ("mcap",), "dataflash": ("pymavlink.DFReader",), "ulog": ("pyulog",)}
"""Pure Python libraries that parse a format for us; their coverage guides the fuzzer through it."""
_MEMORY_MB = 2500


def main() -> None:
    """Run the target. This never returns: libFuzzer ends the process."""
    parser = argparse.ArgumentParser()
    parser.add_argument("name", choices=sorted(target.MODULES))
    parser.add_argument("--until", type=float, required=True, help="instant of CLOCK_MONOTONIC, s")
    parser.add_argument("--work", type=Path, required=True, help="folder of the growing corpus")
    parser.add_argument("--crashes", type=Path, required=True)
    parser.add_argument("--hang", type=int, required=True, help="time after which an input hangs, s of the clock on the wall")
    args = parser.parse_args()
    logging.disable(logging.CRITICAL)
    warnings.simplefilter("ignore")
    with atheris.instrument_imports(include=[*OURS, *_OTHERS.get(args.name, ())]):
        chosen = target.target(args.name)
    found = target.Finds(args.name, args.crashes, ROOT)

    def fault_of(data: bytes) -> BaseException | None:
        try:
            chosen.run(data)
        except (Exception, SystemExit, BaseExceptionGroup) as why:
            return why
        return None

    def one(data: bytes) -> None:
        # An error that the same input does not show again comes from the machine (memory, descriptors, a late thread).
        if fault_of(data) is not None and (why := fault_of(data)) is not None:
            found.note(data, why)

    one(b"")
    args.work.mkdir(parents=True, exist_ok=True)
    args.crashes.mkdir(parents=True, exist_ok=True)
    left_s = max(1, round(args.until - time.monotonic()))
    options = [
        sys.argv[0], str(args.work), str(target.CORPUS / args.name), f"-max_total_time={left_s}", f"-max_len={chosen.max_len}",
        f"-timeout={args.hang}", f"-rss_limit_mb={_MEMORY_MB}", "-print_final_stats=1",
        f"-artifact_prefix={args.crashes}/{args.name}-",
    ]  # fmt: skip
    atheris.Setup(options, one, internal_libfuzzer=True)
    atheris.Fuzz()


if __name__ == "__main__":
    main()
