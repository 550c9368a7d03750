"""Scenario files: what is shipped holds, and what is wrong is named with key, unit and file."""

import re
import tomllib
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from msgspec import inspect

from companion.settings.schema import unit_of, walk
from estimator.contracts.errors import BadInput
from sitl.faults.kinds import KINDS
from sitl.scenario.scenario import Scenario, camera_model, from_mapping, load
from sitl.sea.sea import SEA_STATES

REFUSED = tomllib.loads(Path(__file__).with_name("refused_scenarios.toml").read_text())["case"]


def test_a_loaded_scenario_holds_from_anywhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "near.toml").write_text((Path("configs/cameras/sim.toml")).read_text())
    (tmp_path / "mine.toml").write_text('title = "mine"\n[camera]\nfile = "near.toml"\n')
    scenario = load(tmp_path / "mine.toml")
    monkeypatch.chdir(tmp_path.parent)
    assert camera_model(scenario).fx == pytest.approx(374.67)


@pytest.mark.parametrize(("data", "said"), [(case["data"], case["said"]) for case in REFUSED])
def test_refusals_name_the_key_and_its_unit(data: dict[str, Any], said: str) -> None:
    with pytest.raises(BadInput, match=rf"\Amine\.toml: [^\n]*{re.escape(said)}[^\n]*\Z"):
        from_mapping({"title": "x", **data}, "mine.toml")


def test_a_base_gives_what_is_not_reported_and_its_faults_come_first(tmp_path: Path) -> None:
    (tmp_path / "low.toml").write_text(
        'title = "low"\nbase = "sea_state_4"\n[start]\nheight_m = 3.0\n[[faults]]\nkind = "flow_blind"\nat_s = 1.0\n'
    )
    (tmp_path / "lower.toml").write_text(
        'title = "lower"\nbase = "low.toml"\n[camera]\nexposure_s = 0.004\n[[faults]]\nkind = "low_battery"\nat_s = 2.0\n'
    )
    scenario, rough = load(tmp_path / "lower.toml"), load("sea_state_4")
    assert (scenario.sea, scenario.camera.file) == (rough.sea, rough.camera.file)
    assert (scenario.start.height_m, scenario.start.pad_right_m) == (3.0, rough.start.pad_right_m)
    assert scenario.camera.exposure_s == 0.004
    assert [fault.kind for fault in scenario.faults] == ["flow_blind", "low_battery"]


def test_a_sea_state_takes_the_place_of_the_height_of_a_base(tmp_path: Path) -> None:
    rough = load("sea_state_4")
    for code in range(7):
        scenario = load(f"sea_state_{code}")
        system, *swells = scenario.sea.systems()
        assert (system.state.hs_m, system.state.tp_s) == (SEA_STATES[code].hs_m, SEA_STATES[code].tp_s)
        assert [swell.state.hs_m for swell in swells] == pytest.approx([0.5 * system.state.hs_m] * (code > 1), abs=0.006)
        assert (scenario.sea.runs_to_deg, scenario.vessel, scenario.wind) == (rough.sea.runs_to_deg, rough.vessel, rough.wind)
    lower = "[sea]\nsignificant_height_m = 2.9\npeak_period_s = 9.0\n"
    (tmp_path / "lower.toml").write_text(f'title = "l"\nbase = "sea_state_5"\n{lower}')
    (system,) = load(tmp_path / "lower.toml").sea.systems()
    assert (system.state.hs_m, system.state.tp_s) == (2.9, 9.0)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ('base = "low.toml"\n[[faults]]\nkind = "rain"\nat_s = 1.0\n', r"mine\.toml: faults\[0\]\.kind must be one of"),
        ('base = "sick.toml"\n', r"sick\.toml: sea must be a table"),
        ('base = "mine.toml"\n', r"mine\.toml: base leads back to this file"),
        ('base = "dmo"\n', r"mine\.toml: base: .*did you mean 'demo'"),
        ('[pad]\nfile = "thesi"\n', r"mine\.toml: pad\.file: .*did you mean 'thesis'"),
        ("sea = \n", r"mine\.toml: not valid TOML"),
    ],
)
def test_an_error_is_named_in_the_file_it_is_in(tmp_path: Path, text: str, said: str) -> None:
    (tmp_path / "low.toml").write_text('title = "low"\n[[faults]]\nkind = "flow_blind"\nat_s = 1.0\n')
    (tmp_path / "sick.toml").write_text('title = "sick"\nsea = 3\n')
    (tmp_path / "mine.toml").write_text(f'title = "mine"\n{text}')
    with pytest.raises(BadInput, match=said):
        load(tmp_path / "mine.toml")
    with pytest.raises(BadInput, match=r"scenario: there is no file 'dmo' .*did you mean 'demo'"):
        load("dmo")


def test_every_number_says_its_unit_range_and_meaning() -> None:
    endings = {
        "m": "_m", "s": "_s", "m/s": "_m_s", "deg": "_deg", "deg/s": "_deg_s", "Hz": "_hz", "K": "_k", "kg": "_kg",
        "px": "_px", "Pa": "_pa", "T": "_t", "m/s^2": "_m_s2", "rad/s": "_rad_s",
        "m/s^3": "_m_s3", "deg/s^2": "_deg_s2", "Pa/s": "_pa_s", "uT": "_ut", "uT/s": "_ut_s", "per min": "per_minute",
        "kbit/s": "_kbit_s", "id": "_id", "km": "_km", "1/m": "_per_m",
    }  # fmt: skip
    keys = [*walk(Scenario), *(key for kind in KINDS.values() for key in walk(kind))]
    assert len(keys) > 60
    for path, field in keys:
        spot = field.type.types[0] if isinstance(field.type, inspect.UnionType) else field.type
        kind = getattr(spot, "type", None)
        extra = getattr(spot, "extra_json_schema", None) or {}
        if type(kind).__name__ in ("FloatType", "IntType"):
            assert kind.ge is not None, path
            assert kind.le is not None, path
            assert extra["description"], path
            unit = unit_of(field.type)
            assert unit, path
            if unit != "1":
                assert path.endswith(endings[unit]), path


@settings(max_examples=60)
@given(
    st.recursive(
        st.none() | st.booleans() | st.floats() | st.integers() | st.text(max_size=8),
        lambda inner: (
            st.lists(inner, max_size=3)
            | st.dictionaries(st.sampled_from([*Scenario.__struct_fields__, "hull", "file", "kind", "at_s"]), inner, max_size=5)
        ),
        max_leaves=8,
    )
)
def test_any_data_is_a_scenario_or_one_clear_line(data: Any) -> None:
    table = data if isinstance(data, dict) else {"faults": data}
    try:
        from_mapping(table, "any.toml")
    except BadInput as why:
        output = str(why)
    else:
        output = "any.toml: good"
    assert output.startswith("any.toml: ")
    assert "\n" not in output
