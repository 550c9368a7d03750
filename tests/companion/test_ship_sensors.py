"""A ship's own sensors, judged by what they reported, from logs of her sentences through a recording to the verdicts."""

import json
import math
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from companion.cli import main as cli
from companion.tools.replay.ship_sensors import SensorJudge
from estimator.contracts.geometry import F64, GeoPoint
from estimator.contracts.samples import GeoFix, Sample, VesselMotion, VesselReport
from estimator.contracts.time import Stamp
from tests.drivers.nmea.test_sentences import line
from tests.drivers.nmea.test_ship_sensors import PALMER, needs_palmer
from tests.make import ns

T = np.arange(0.0, 120.0, 0.2)
WAVES = 0.8 * np.sin(2.0 * np.pi * T / 7.0) + 0.3 * np.sin(2.0 * np.pi * T / 11.0)


def measured(t: float) -> Stamp:
    return Stamp(ns(10.0 + t), ns(10.0 + t), 0.01, "arrival")


def heaves(sensor: str, heave_m: F64, late_s: float = 0.0) -> list[VesselMotion]:
    return [VesselMotion(measured(t + late_s), sensor, 0.02 * h, 0.01, 0.0, h) for t, h in zip(T, heave_m.tolist(), strict=True)]


def judge(samples: Iterable[Sample]) -> SensorJudge:
    sensors = SensorJudge()
    for sample in samples:
        sensors.on_sample(sample)
    return sensors


def faults(*sensors: list[VesselMotion]) -> dict[str, str | None]:
    return {one.sensor: one.fault for one in judge(s for sensor in sensors for s in sensor).verdicts()}


def test_a_heave_that_wanders_is_named_and_waves_swell_and_calm_water_are_not() -> None:
    wander = 0.05 * WAVES + 1.5 * np.sin(2.0 * np.pi * T / 90.0)
    found = faults(
        heaves("waves", WAVES), heaves("wander", wander), heaves("calm", 0.01 * WAVES),
        heaves("swell", np.sin(2.0 * np.pi * T / 18.0)), heaves("both", WAVES + 0.1 * wander),
        heaves("stuck", np.full(len(T), 0.4)),
    )  # fmt: skip
    assert [name for name, fault in found.items() if fault] == ["stuck", "wander"]
    assert "wanders" in str(found["wander"])
    assert "never change" in str(found["stuck"])
    short = judge(heaves("wander", wander)[:200]).verdicts()[0]
    assert (short.fault, short.wanders_m) == (None, None), "forty seconds are too short to say"


def test_two_sensors_differ_by_their_offset_and_their_delay_and_gaps_are_counted() -> None:
    late = heaves("b", WAVES + 0.2, 0.3)
    holed = [s for s in late if not 40.0 < s.stamp.measured_at * 1e-9 < 45.0]
    sensors = judge([*heaves("a", WAVES), *holed])
    (heave,) = (d for d in sensors.differences() if d.part == "heave")
    assert (heave.mean, heave.lag_s) == pytest.approx((0.2, 0.3), abs=0.01)
    assert heave.sd < 0.01
    a, b = sensors.verdicts()
    assert (a.gaps, b.gaps, a.rate_hz) == (0, 1, pytest.approx(5.0))
    assert b.longest_gap_s == pytest.approx(5.0, abs=0.3)
    pairs = [t + late for t in T for late in (0.0, 2.4e-5)]
    (twice,) = judge(GeoFix(measured(t), "vessel", GeoPoint(0.0, 0.0, 0.0), 1.0) for t in pairs).verdicts()
    assert (twice.gaps, twice.rate_hz) == (0, pytest.approx(10.0, rel=0.01)), "both of each instant"


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_rate_of_turn_of_the_wrong_sense_shows(sign: float) -> None:
    sensors = SensorJudge()
    for t in T.tolist():
        sensors.on_sample(VesselReport(measured(t), None, None, (6.2 + 0.4 * math.sin(0.1 * t)) % math.tau, 0.03))
        sensors.on_sample(VesselReport(measured(t), None, None, None, None, sign * 0.04 * math.cos(0.1 * t), 0.001))
    assert sensors.turns_against_heading() == pytest.approx(sign, abs=0.05)


def rig(folder: Path) -> str:
    """Return a settings file that knows a ship."""
    tables = '[vehicle]\nkind = "ardrone"\n[camera]\nfile = "sim"\n[pad]\nfile = "thesis"\n[vessel]\nnmea = "0.0.0.0:10110"\n'
    (folder / "rig.toml").write_text(tables)
    return str(folder / "rig.toml")


def imported(tmp_path: Path, *logs: Path, capsys: pytest.CaptureFixture[str]) -> dict[str, Any]:
    """Return the verdicts of `replay` on what `record import` made of logs, by sensor."""
    recording = tmp_path / "ship.mcap"
    assert cli.main(["record", "import", *map(str, logs), "--config", rig(tmp_path), "--output", str(recording)]) == 0
    capsys.readouterr()
    assert cli.main(["replay", str(recording), "--json"]) == 0
    out = json.loads(capsys.readouterr().out)
    return {one["sensor"]: one for one in out["ship_sensors"]} | {"differences": out["ship_differences"]}


def begun(folder: Path, log: Path) -> Path:
    """Return the first two fifths of a log: the replay of more, some minutes, says the same."""
    lines = log.read_bytes().splitlines(keepends=True)
    (folder / log.name).write_bytes(b"".join(lines[: 2 * len(lines) // 5]))
    return folder / log.name


@needs_palmer
def test_logs_of_a_ship_become_a_recording_whose_replay_judges_her_sensors(tmp_path, capsys):
    found = imported(tmp_path, *(begun(tmp_path, PALMER / f"{name}.txt") for name in ("s330", "seap", "gyr1")), capsys=capsys)
    assert found["heading"]["rate_hz"] == pytest.approx(5.0, rel=0.05)
    for sensor in ("s330 IN PSXN", "seap GP PSXN"):
        one = found[sensor]
        assert (one["fault"], one["rate_hz"]) == (None, pytest.approx(1.0, rel=0.05))
        parts = {part["name"]: part for part in one["parts"]}
        assert 0.5 < parts["roll"]["sd"] < 0.65
        assert 1.0 < parts["heave"]["sd"] < 1.2
        assert [parts[name]["step"] for name in ("roll", "pitch", "heave")] == pytest.approx([0.01] * 3, rel=0.01)
    apart = {one["part"]: one for one in found["differences"]}
    assert apart["roll"]["sd"] < 0.03
    assert abs(apart["pitch"]["lag_s"]) < 0.05
    assert apart["heave"]["sd"] < 0.1


@pytest.mark.parametrize(
    "before",
    [
        "", "2026-11-29T23:59:{s:06.3f}Z ", "11/29/2026,23:59:{s:06.3f},", "{unix:.3f} ", "[23:59:{s:06.3f}] ", "{s:.2f} ",
        "\\s:bridge,c:{unix:.0f}*12\\",
    ],
)  # fmt: skip
def test_a_log_has_a_logger_s_time_or_its_own(tmp_path, capsys, before):
    log, rows = tmp_path / "ship.log", []
    for n in range(90):
        s = n % 60
        clock = f"23{59:02d}{s:02d}.00" if n < 60 else f"0000{s:02d}.00"
        when = before.replace("23:59", "23:59" if n < 60 else "00:00").replace("29T", "29T" if n < 60 else "30T")
        when = when.replace("11/29", "11/29" if n < 60 else "11/30").format(
            s=n if before.startswith("{s") else s, unix=1.79e9 + n
        )
        for body in (f"GPGGA,{clock},5424.01800,N,01012.06600,E,1,12,0.8,4.0,M,45.0,M,,", f"PSXN,23,1.{s:02d},2.0,,0.5"):
            rows.append(when + line(body).decode().strip())
    if before.startswith("{unix"):  # some write the time behind
        rows = [f"{row.partition(' ')[2]} ; {row.partition(' ')[0]}" for row in rows]
    log.write_text("\n".join([*rows, "the end"]) + "\n")
    found = imported(tmp_path, log, capsys=capsys)
    assert (found["PSXN"]["count"], found["PSXN"]["rate_hz"], found["PSXN"]["gaps"]) == (90, pytest.approx(1.0, abs=0.02), 0)


def test_sentences_between_two_with_a_time_lie_evenly_between_them(tmp_path, capsys):
    log, rows = tmp_path / "ship.log", []
    for n in range(700):
        if n % 10 == 0:
            rows.append(line(f"GPRMC,1200{n // 10 % 60:02d}.00,A,5424.01800,N,01012.06600,E,005.4,000.0,211126,,,A"))
        rows.append(line(f"YXXDR,A,{1.0 + math.sin(0.1 * n):.2f},D,ROLL"))
    log.write_bytes(b"".join(rows[:660]))
    one = imported(tmp_path, log, capsys=capsys)["YX XDR"]
    assert (one["count"], one["rate_hz"], one["gaps"]) == (600, pytest.approx(10.0, rel=0.01), 0)


def test_a_log_without_any_time_or_without_a_ship_is_refused(tmp_path, capsys):
    log = tmp_path / "ship.log"
    log.write_bytes(20 * line("HEHDT,90.0,T"))
    for settings, why in ((rig(tmp_path), "no time in it"), ("ardrone2", "text, and no video or flight; give settings")):
        assert cli.main(["record", "import", str(log), "--config", settings, "--output", str(tmp_path / "out.mcap")]) == 2
        assert why in capsys.readouterr().err
