"""Every command where nothing of its surroundings may be assumed.

The user is a number without a name, a home or rights; every disk but the working folder is read-only; /dev/shm is shut; and
PYTHONPATH holds code of others.
"""

import json
import shutil
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

from companion.cli.commands import COMMANDS
from companion.settings.load import camera_model, load

ROOT = Path(__file__).resolve().parents[2]

PLACE = """
mount --bind "$1" "$1" || exit 77
awk '{print $5}' /proc/self/mountinfo | sort -u | while read -r m; do
    case "$m" in "$1"|/proc*|/dev*) ;; *) mount -o remount,bind,ro "$m" 2>/dev/null ;; esac
done
mount -t tmpfs -o mode=000 none /dev/shm || exit 77
cd "$1" && shift && exec unshare -U --map-user=1234567 --map-group=7654321 "$@"
"""
RUN = """
import contextlib, io, json, os, sys, traceback
from companion.cli.main import main
assert os.getuid() == 1234567 and not os.access("/tmp", os.W_OK) and not os.access("/dev/shm", os.R_OK | os.X_OK)
for words in json.load(open("commands.json")):
    said = io.StringIO()
    with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said):
        try:
            code = main(words)
        except SystemExit as end:
            code = end.code
        except BaseException:
            code = traceback.format_exc()
    print(json.dumps([words, code, said.getvalue()[-2000:]]), flush=True)
"""
DONE = [
    ["detect", "pad.png", "--camera", "sim"], ["config", "check", "sim"], ["run", "--config", "sim", "--check"],
    ["record", "import", "still.csv", "--config", "sim", "--output", "still.mcap"], ["record", "info", "still.mcap"],
    ["record", "export", "still.mcap", "--output", "tables"], ["record", "upload", ".", "--to", "there"],
    ["keys", "token", "page.token"], ["pad", "print", "thesis", "--out", "pad.pdf"],
    ["campaign", "calm", "--runs", "1", "--seed", "3", "--perception", "model", "--workers", "1", "--out", "flights"],
]  # fmt: skip

SAID = {"detect": "found in 0 of 1 frames", "campaign": "is /dev/shm there and writable?"}
"""Words printed by commands that cannot end with 0 here: there is no pad, and no shared memory for processes."""


def test_every_command_works_for_a_number_without_home_rights_or_shared_memory(tmp_path: Path) -> None:
    if shutil.which("unshare") is None or subprocess.run(["unshare", "-rm", "true"], capture_output=True).returncode:
        pytest.skip("no namespace may be made here")
    camera = camera_model(load("sim"))
    cv2.imwrite(str(tmp_path / "pad.png"), np.full((camera.height, camera.width, 3), 120, np.uint8))
    rows = "".join(f"{k / 50:.3f},0.1,0.2\n" for k in range(50))
    (tmp_path / "still.csv").write_text(f"time_s,roll_deg,pitch_deg\n{rows}")
    (tmp_path / "robot").mkdir()
    (tmp_path / "robot" / "robot.py").write_text("raise RuntimeError('this is not yours')\n")
    commands = [*([name, "--help"] for name in COMMANDS), *DONE]
    (tmp_path / "commands.json").write_text(json.dumps(commands))
    bare = [
        "env",
        "-i",
        "PATH=/usr/bin:/bin",
        f"TMPDIR={tmp_path}",
        f"PYTHONPATH={tmp_path / 'robot'}:{ROOT}",
        "PYTHONDONTWRITEBYTECODE=1",
    ]
    words = ["unshare", "-rm", "sh", "-c", PLACE, "sh", str(tmp_path), *bare, sys.executable, "-c", RUN]
    done = subprocess.run(words, capture_output=True, text=True)
    if done.returncode == 77:
        pytest.skip(f"nothing may be mounted here: {done.stderr[-200:]}")
    ended = [json.loads(line) for line in done.stdout.splitlines()]
    assert [words for words, _, _ in ended] == commands, done.stderr[-2000:]
    for words, code, said in ended:
        assert "Traceback" not in said, (words, said)
        assert not code or SAID.get(words[0], "no way to fail") in said, (words, code, said)
