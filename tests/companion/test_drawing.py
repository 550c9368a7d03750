"""A service without the extra `report`: commands that draw say so before they work, and nothing else requests matplotlib."""

import subprocess
import sys

import pytest

from companion.cli.main import main
from companion.tools.report.drawing import require_drawing
from estimator.contracts.errors import BadInput


def test_a_missing_matplotlib_is_named_with_its_cure(monkeypatch: pytest.MonkeyPatch) -> None:
    require_drawing("--plot")
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    with pytest.raises(BadInput, match=r"--plot draws with matplotlib, .* requirements/report\.txt"):
        require_drawing("--plot")


@pytest.mark.parametrize(
    "words",
    [
        ["calibrate", "camera", "{}", "--out", "{}/camera.toml", "--figures", "{}"],
        ["campaign", "demo", "--soak", "--plot", "{}/soak.svg", "--hours", "1"],
    ],
    ids=lambda words: words[0],
)
def test_every_command_that_draws_refuses_at_once(words, tmp_path, monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    assert main([word.format(tmp_path) for word in words]) == 2
    assert "matplotlib, which is not installed" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


_ALL_HELP = """
import sys
sys.modules["matplotlib"] = None
from companion.cli.main import COMMANDS, main
for command in COMMANDS:
    try:
        main([command, "--help"])
    except SystemExit as end:
        assert end.code == 0, command
assert "sitl.campaign.soak" in sys.modules
"""


def test_every_command_has_its_help_without_matplotlib() -> None:
    assert subprocess.run([sys.executable, "-c", _ALL_HELP], capture_output=True, text=True, check=False).stderr == ""
