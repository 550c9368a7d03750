"""The shipped layout for Foxglove names what a recording holds: topics, the kinds of their messages, fields and frames."""

import json
import re
from collections import defaultdict
from pathlib import Path
from typing import Any

import pytest
from mcap.reader import make_reader

from companion.cli.main import main

ROOT = Path(__file__).parents[2]
LAYOUT: dict[str, Any] = json.loads((ROOT / "configs/viewer/foxglove.json").read_text())
PANELS: dict[str, Any] = LAYOUT["configById"]
DRAWN_IN_3D = {"foxglove.SceneUpdate", "foxglove.PoseInFrame", "foxglove.PosesInFrame", "foxglove.FrameTransforms"}
IMAGES = {"foxglove.CompressedImage", "foxglove.CompressedVideo", "foxglove.RawImage"}
PATH = re.compile(r'(?P<topic>/[\w/]+)(?:\{(?P<key>\w+)==(?P<value>"[^"]*"|[\w.-]+)\})?(?P<fields>(?:\.\w+|\[\d+\])*)')
"""A message path: a topic, a filter by one field, and fields and indices. Source: docs.foxglove.dev, message path syntax."""
Messages = dict[str, list[dict[str, Any]]]


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> tuple[dict[str, str], Messages]:
    """Return the schema of each topic of a simulated landing's first seconds, and its messages."""
    path = tmp_path_factory.mktemp("layout") / "flight.mcap"
    assert main(["simulate", "demo", "--seed", "1", "--set", "duration_limit_s=2.5", "--record", str(path)]) == 1
    kinds: dict[str, str] = {}
    messages: Messages = defaultdict(list)
    with path.open("rb") as stream:
        for schema, channel, message in make_reader(stream).iter_messages():
            assert schema is not None
            kinds[channel.topic] = schema.name
            messages[channel.topic].append(json.loads(message.data))
    return kinds, messages


def layout_values(path: str, messages: Messages) -> list[Any]:
    """Return what a message path finds in the messages."""
    found = PATH.fullmatch(path)
    assert found is not None, f"{path} is no message path"
    steps = [int(i) if i else name for name, i in re.findall(r"\.(\w+)|\[(\d+)\]", found["fields"])]
    out = []
    for message in messages[found["topic"]]:
        if found["key"] is not None and message.get(found["key"]) != json.loads(found["value"]):
            continue
        value: Any = message
        for step in steps:
            there = value is not None and (step < len(value) if isinstance(step, int) else step in value)
            value = value[step] if there else None
        out += [] if value is None else [value]
    return out


def panels_of(kind: str) -> list[tuple[str, Any]]:
    return [(name, config) for name, config in PANELS.items() if name.partition("!")[0] == kind]


def leaves(node: Any) -> list[str]:
    return [node] if isinstance(node, str) else [*leaves(node["first"]), *leaves(node["second"])]


def test_each_panel_stands_once_in_the_layout() -> None:
    assert sorted(leaves(LAYOUT["layout"])) == sorted(PANELS)
    assert {name.partition("!")[0] for name in PANELS} == {"3D", "Image", "Plot", "StateTransitions", "RosOut"}


def test_plots_and_states_find_values_in_a_recording(recorded: tuple[dict[str, str], Messages]) -> None:
    _, messages = recorded
    plotted = [path["value"] for _, config in panels_of("Plot") for path in config["paths"]]
    assert len(plotted) > 5
    for path in plotted:
        found = layout_values(path, messages)
        assert len(found) > 10, path
        assert all(isinstance(value, int | float) for value in found), path
    for path in [path["value"] for _, config in panels_of("StateTransitions") for path in config["paths"]]:
        assert {type(value) for value in layout_values(path, messages)} == {str}, path


def test_images_scenes_and_logs_are_of_the_kinds_that_their_panels_show(recorded: tuple[dict[str, str], Messages]) -> None:
    kinds, messages = recorded
    for _, config in panels_of("Image"):
        mode = config["imageMode"]
        assert kinds[mode["imageTopic"]] in IMAGES
        assert kinds[mode["calibrationTopic"]] == "foxglove.CameraCalibration"
        assert {kinds[topic] for topic in mode["annotations"]} == {"foxglove.ImageAnnotations"}
    transforms = [t for topic in ("/tf", "/tf_static") for m in messages[topic] for t in m["transforms"]]
    frames = {t[end] for t in transforms for end in ("parent_frame_id", "child_frame_id")}
    for _, config in panels_of("3D"):
        assert {kinds[topic] for topic in config["topics"]} <= DRAWN_IN_3D
        assert config["followTf"] in frames
        for topic in config["topics"]:
            shown = messages[topic]
            named = {m["frame_id"] for m in shown if "frame_id" in m} | {
                e["frame_id"] for m in shown for e in m.get("entities", ())
            }
            assert named, topic
            assert named <= frames, topic
    assert {kinds[config["topicToRender"]] for _, config in panels_of("RosOut")} == {"foxglove.Log"}


def test_the_paths_that_the_docs_name_are_there(recorded: tuple[dict[str, str], Messages]) -> None:
    text = (ROOT / "docs/recordings.md").read_text()
    named = re.findall(r"`(/(?:belief|fusion|truth|detection)[^`]*\.[^`]+)`", text)
    assert len(named) >= 4
    for path in named:
        assert layout_values(path, recorded[1]), path
