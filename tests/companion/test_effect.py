"""Keys that change nothing are reported."""

from pathlib import Path
from typing import Any

import pytest

from companion.cli.main import main
from companion.settings.effect import without_effect
from companion.settings.load import from_mapping, load, shipped

ARDRONE: dict[str, Any] = {"vehicle": {"kind": "ardrone"}, "camera": {"file": "sim"}, "pad": {"file": "thesis"}}
AUTOPILOT: dict[str, Any] = ARDRONE | {"vehicle": {"kind": "mavlink", "links": "udpin://127.0.0.1:14550"}}


@pytest.mark.parametrize(
    ("data", "said"),
    [
        (ARDRONE, ()),
        (ARDRONE | {"mqtt": {"transport": "tls", "host": "broker"}}, ()),
        (
            ARDRONE | {"mqtt": {"host": "broker", "drone": "deck"}},
            ('mqtt.drone, mqtt.host: without effect, as mqtt.transport is "off"',),
        ),
        (ARDRONE | {"mqtt": {"host": "127.0.0.1"}}, ()),
        (ARDRONE | {"bridge": {"system_id": 7}}, ("bridge.system_id: without effect, as bridge.links is empty",)),
        (ARDRONE | {"video_stream": {"drawn": False}}, ("video_stream.drawn: without effect, as video_stream.to is empty",)),
        (ARDRONE | {"http": {"port": 1}}, ('http.port: without effect, as http.endpoint is "off"',)),
        (
            ARDRONE | {"vessel": {"jump_m": 20.0}},
            ("expert.vessel.jump_m: without effect, as no source of the ship's place is set",),
        ),
        (
            ARDRONE | {"guidance": {"rendezvous": {"range_m": 9.0}}, "vessel": {"nmea": "127.0.0.1:10110", "mmsi": 7}},
            ("guidance.rendezvous.range_m: without effect, as guidance.rendezvous.enabled is false",),
        ),
        (
            AUTOPILOT | {"landing_target": {"ranges": "off", "range_rate_hz": 5.0}},
            ('expert.landing_target.range_rate_hz: without effect, as landing_target.ranges is "off"',),
        ),
        (
            ARDRONE | {"estimator": {"ekf": {"min_confidence": 0.1}}},
            (
                "expert.estimator.ekf.min_confidence: without effect, as it does not exceed estimator.min_confidence, "
                "which refuses before",
            ),
        ),
    ],
)
def test_a_key_without_effect_is_reported_with_the_cause(data: dict[str, Any], said: tuple[str, ...]) -> None:
    assert without_effect(from_mapping(data, "x")) == said


@pytest.mark.parametrize("name", shipped())
def test_no_shipped_profile_sets_a_key_without_effect(name: str) -> None:
    assert without_effect(load(name)) == ()


def test_check_reports_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "own.toml"
    file.write_text('vehicle.kind = "ardrone"\ncamera.file = "sim"\npad.file = "thesis"\nmqtt.host = "broker"\n')
    assert main(["config", "check", str(file)]) == 0
    assert capsys.readouterr().out == f'{file}: good\n{file}: mqtt.host: without effect, as mqtt.transport is "off"\n'
    assert main(["run", "--check", "--config", str(file)]) == 0
    assert 'mqtt.host: without effect, as mqtt.transport is "off"' in capsys.readouterr().out


@pytest.mark.parametrize(
    ("lines", "said"),
    [
        ("guidance.rendezvous.enabled = true", "nothing tells where the ship is: set a source (vessel.nmea, vessel.mqtt)"),
        ('vessel.nmea = "127.0.0.1:10110"', "vessel.nmea: the ship's velocity and heading are used, her place is not"),
        (
            'vessel.nmea = "127.0.0.1:10110"\nvessel.mmsi = 211234560\nguidance.rendezvous.enabled = true',
            "expert.vessel.age_max_s is 5 s, but AIS reports of a ship under way come every 10 s",
        ),
        ('vessel.nmea = "127.0.0.1:10110"\nguidance.rendezvous.enabled = true', None),
    ],
)
def test_what_does_not_go_together_about_the_ship_s_place_is_reported(lines, said, tmp_path, capsys):
    file = tmp_path / "own.toml"
    file.write_text(f'vehicle.kind = "ardrone"\ncamera.file = "sim"\npad.file = "thesis"\n{lines}\n')
    assert main(["config", "check", str(file)]) == 0
    reported = capsys.readouterr().out.splitlines()[1:]
    assert [line for line in reported if said is not None and said in line] == reported
    assert len(reported) == (0 if said is None else 1)
