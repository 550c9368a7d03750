"""A missing extra is reported in one line that names its installation."""

from pathlib import Path

from companion.cli import main as cli
from companion.tools.ros2 import typestore

GOLDEN = Path(__file__).parents[2] / "golden/frames.mcap"


def test_without_the_library_one_line_says_how_to_get_it(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(typestore, "find_spec", lambda name: None)
    assert cli.main(["record", "export", str(GOLDEN), "--format", "ros2", "--output", str(tmp_path / "bag")]) == 2
    printed = capsys.readouterr().err
    assert printed.count("\n") == 1
    assert "decklander[ros2]" in printed
    assert not (tmp_path / "bag").exists()
