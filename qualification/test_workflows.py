"""Every `run:` line of the workflows is executed here as there; a line that wants the cloud is named with the reason."""

import os
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from ruamel.yaml import YAML

from supply import release

ROOT = Path(__file__).parents[1]
WORKFLOWS = sorted((ROOT / ".github/workflows").glob("*.yml"))
ELSEWHERE = {
    "apt-get update -qq && apt-get install -qq --yes git ca-certificates": "it changes the system",
    ".ci/run": "it runs this test",
    'gh release create "$GITHUB_REF_NAME" --verify-tag --title "$GITHUB_REF_NAME" --notes "See CHANGELOG.md." release/*': (
        "wants GitHub and a token"
    ),
}
"""Lines that are not executed here, with the reason."""
NO_NETWORK = re.compile(r"No matching distribution|Failed to establish a new connection|Temporary failure in name resolution")


def jobs() -> list[tuple[str, dict[str, Any]]]:
    loaded = [(file.name, YAML(typ="safe").load(file.read_text())) for file in WORKFLOWS]
    return [(f"{name} {job}", text) for name, found in loaded for job, text in found["jobs"].items()]


def lines() -> list[str]:
    return list(dict.fromkeys(step["run"].strip() for _, job in jobs() for step in job["steps"] if "run" in step))


def test_the_linter_and_the_schemas_find_nothing() -> None:
    done = subprocess.run(
        ["make", "-s", "workflows", f"VENV={sys.prefix}"], cwd=ROOT, capture_output=True, text=True, check=False
    )
    if NO_NETWORK.search(done.stderr):
        pytest.skip("pip reaches no packages here")
    assert done.returncode == 0, done.stdout + done.stderr


def test_each_line_that_is_not_executed_here_is_in_a_workflow() -> None:
    assert set(ELSEWHERE) <= set(lines())


def test_jobs_end_by_themselves_and_a_checkout_has_the_tags_and_keeps_no_token() -> None:
    for name, job in jobs():
        assert "timeout-minutes" in job or not any(
            "run" in step and step["run"].startswith(("make", ".ci")) for step in job["steps"]
        ), name
        for step in job["steps"]:
            if step.get("uses", "").startswith("actions/checkout@"):
                assert step["with"] == {"fetch-depth": 0, "persist-credentials": False}, name


@pytest.mark.parametrize("line", [line for line in lines() if line not in ELSEWHERE])
def test_a_line_does_here_what_it_does_there(line: str, tmp_path: Path) -> None:
    """`make` and our modules work on this checkout and its environment, all else in an empty folder, with a home of its own."""
    made = [f"release/decklander-1.0.0{end}" for end in (".tar.gz", "-py3-none-any.whl")]
    for name in (*made, "release/decklander-site.tar.gz", "release/SHA256SUMS"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).touch()
    ours = line.startswith(("make", ".venv"))
    text = line.replace(".venv/bin", f"{sys.prefix}/bin").replace("make ", f"make VENV={sys.prefix} ")
    environment = os.environ | {"HOME": os.environ["HOME"] if ours else str(tmp_path)}
    done = subprocess.run(
        ["bash", "-e", "-o", "pipefail", "-c", text], cwd=ROOT if ours else tmp_path, env=environment,
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    if NO_NETWORK.search(done.stderr):
        pytest.skip("pip reaches no packages here")
    wanted = int(bool(release.missing())) if "supply.release" in line else 0
    assert done.returncode == wanted, done.stdout[-3000:] + done.stderr[-3000:]
    if "mv release" in line:
        assert {path.name for path in (tmp_path / "dist").iterdir()} == {Path(name).name for name in made}
