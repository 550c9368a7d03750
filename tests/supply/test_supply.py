"""What is shipped is listed, under licences that are known, and known weaknesses of it fail the audit."""

from __future__ import annotations

import json
import sys
import zipfile
from dataclasses import replace
from pathlib import Path

import pytest

from supply import audit, licences, sbom
from supply.packages import READ, ROOT, Package, Pin, every_pin, extras, installed, packages, pins

SHIPPED = packages(every_pin())


def test_every_pinned_distribution_has_a_known_licence_and_the_page_is_that_of_today() -> None:
    assert len(SHIPPED) > 20
    assert licences.unknown(SHIPPED) == []
    assert licences.unknown([*SHIPPED, replace(SHIPPED[0], licence=None)]) == [SHIPPED[0].pin.name]
    assert (ROOT / "docs/licences.md").read_text() == licences.page(SHIPPED), "make licences"
    assert set(READ) <= {p.pin.name for p in SHIPPED}, "an entry for what is no longer shipped"


def test_what_is_under_the_gpl_is_named_with_what_carries_it() -> None:
    rows = licences.copyleft(SHIPPED)
    of_their_own = [row for row in rows if "of its own" in row]
    assert [row for row in of_their_own if "LGPL" not in row] == [], "a distribution under the GPL is needed by the service"
    assert any("pymavlink" in row for row in of_their_own)
    assert any("libx264" in row and "GPL-2.0-or-later" in row and "wheel of av" in row for row in rows)
    libx264 = [p.pin.name for p in SHIPPED if "libx264" in p.libraries or "libx265" in p.libraries]
    assert libx264 == ["av"], "another wheel carries an encoder under the GPL: docs/cameras.md names PyAV alone"
    opencv = next(p for p in SHIPPED if p.pin.name == "opencv-python-headless")
    assert opencv.carried["libavcodec"] == "LGPL-2.1-or-later"
    assert "libavif" not in opencv.carried


def test_pins_are_read_whole() -> None:
    text = (ROOT / "requirements/runtime.txt").read_text()
    assert sum(len(pin.hashes) for pin in pins()) == text.count("--hash=sha256:")
    with pytest.raises(LookupError, match="numpy 0\\.0 is pinned, installed is"):
        packages([Pin("numpy", "0.0", ())])


def test_what_the_extras_add_is_shipped_too(tmp_path: Path) -> None:
    assert "report" in extras()
    assert "dev" not in extras()
    by_name = {pin.name: pin for pin in every_pin()}
    assert (by_name["numpy"].extra, by_name["matplotlib"].extra) == ("", "report")
    bare = tmp_path / "site-packages"
    bare.mkdir()
    assert installed(every_pin(), [str(bare)]) == pins(), "an environment without extras"
    for path in (ROOT / "requirements").glob("*.txt"):
        (tmp_path / path.name).write_text(path.read_text())
    report = tmp_path / "report.txt"
    report.write_text(report.read_text().replace("numpy==", "numpy==0."))
    with pytest.raises(ValueError, match=r"numpy .* is pinned already, and the extra report pins 0"):
        every_pin(tmp_path)


def test_the_bill_lists_every_pin_with_its_hashes_licence_and_needs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    out = tmp_path / "dist/bill.json"
    environment = Path(sys.executable).parents[1]
    monkeypatch.setattr(sys, "argv", ["sbom", "--out", str(out), "--environment", str(environment)])
    assert sbom.main() == 0
    bill = json.loads(out.read_text())
    assert (bill["bomFormat"], bill["specVersion"]) == ("CycloneDX", "1.6")
    assert bill["metadata"]["component"]["name"] == "decklander"
    assert {c["purl"] for c in bill["components"]} == {f"pkg:pypi/{p.name}@{p.version}" for p in every_pin()}
    by_name = {c["name"]: c for c in bill["components"]}
    assert all(c["licenses"] for c in bill["components"])
    assert {c["name"] for c in bill["components"] if c["scope"] == "required"} == {p.name for p in pins()}
    assert by_name["matplotlib"]["scope"] == "optional"
    hashes = by_name["numpy"]["externalReferences"][0]["hashes"]
    assert {h["content"] for h in hashes} == set(next(p for p in pins() if p.name == "numpy").hashes)
    carried = {c["name"]: c for c in by_name["av"]["components"]}
    assert "GPL-2.0-or-later" in json.dumps(carried["libx264"]["licenses"])
    needs = {d["ref"]: d.get("dependsOn", []) for d in bill["dependencies"]}
    assert any(
        ref.startswith("numpy==") for ref in needs[f"opencv-python-headless=={by_name['opencv-python-headless']['version']}"]
    )
    again = json.loads(sbom.bill(SHIPPED, "0.1.0"))
    assert again["serialNumber"] == bill["serialNumber"], "the same pins are the same bill"


def test_the_image_is_made_with_its_bill() -> None:
    dockerfile = (ROOT / "Dockerfile").read_text()
    build, _, last = dockerfile.partition("\nFROM debian:bookworm-slim\nRUN")
    assert "supply.sbom --environment /opt/decklander --out /opt/decklander/share/decklander/sbom.cdx.json" in build
    assert "COPY --from=build /opt/decklander /opt/decklander" in last


def advisory(**affected: object) -> dict[str, object]:
    return {
        "id": "PYSEC-1",
        "summary": "bad",
        "affected": [{"package": {"ecosystem": "PyPI", "name": "Some_Thing"}, **affected}],
    }


@pytest.mark.parametrize(
    ("affected", "hit"),
    [
        ({"versions": ["1.0", "1.5"]}, True),
        ({"versions": ["1.4"]}, False),
        ({"ranges": [{"type": "ECOSYSTEM", "events": [{"introduced": "0"}, {"fixed": "1.5"}]}]}, False),
        ({"ranges": [{"type": "ECOSYSTEM", "events": [{"introduced": "0"}, {"fixed": "1.6"}]}]}, True),
        ({"ranges": [{"type": "ECOSYSTEM", "events": [{"introduced": "0"}, {"last_affected": "1.5"}]}]}, True),
        ({"ranges": [{"type": "ECOSYSTEM", "events": [{"introduced": "2"}]}]}, False),
        ({"ranges": [{"type": "ECOSYSTEM", "events": [{"fixed": "1.2"}, {"introduced": "0"}, {"introduced": "1.4"}]}]}, True),
        ({"ranges": [{"type": "GIT", "events": [{"introduced": "0"}]}]}, False),
        ({"package": {"ecosystem": "npm", "name": "some-thing"}, "versions": ["1.5"]}, False),
    ],
)
def test_an_advisory_is_about_the_versions_it_names(affected: dict[str, object], hit: bool) -> None:
    pin = Pin("some-thing", "1.5", ())
    found = audit.hits([advisory(**affected)], [pin])
    assert found == (["some-thing 1.5: PYSEC-1 bad"] if hit else [])
    assert audit.hits([{**advisory(**affected), "withdrawn": "2026-01-01"}], [pin]) == []


def test_the_audit_reads_a_kept_file_and_fails_on_a_weakness(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    numpy = next(p for p in pins() if p.name == "numpy")
    row = advisory(package={"ecosystem": "PyPI", "name": "numpy"}, versions=[numpy.version])
    archive = tmp_path / "all.zip"
    with zipfile.ZipFile(archive, "w") as made:
        made.writestr("PYSEC-1.json", json.dumps(row))
    folder = tmp_path / "folder"
    folder.mkdir()
    (folder / "a.json").write_text(json.dumps(advisory(versions=["9"])))
    for source, code, said in (
        (archive, 1, f"numpy {numpy.version}: PYSEC-1"),
        (folder, 0, "0 known weaknesses"),
        (tmp_path / "none.zip", 1, audit.COULD_NOT),
    ):
        monkeypatch.setattr(sys, "argv", ["audit", "--advisories", str(source)])
        assert audit.main() == code
        assert said in capsys.readouterr().out


def test_an_audit_that_could_not_be_made_says_so(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    for answer, argv, code, said in (
        ((None, "no route"), [], 0, f"{audit.COULD_NOT}: PyPI gave no answer (no route)"),
        ((None, "no route"), ["--strict"], 1, audit.COULD_NOT),
        (([], "38 asked of PyPI"), [], 0, "0 known weaknesses"),
        ((["numpy 1: PYSEC-2"], "38 asked of PyPI"), [], 1, "PYSEC-2"),
    ):
        monkeypatch.setattr(audit, "ask_pypi", lambda _, answer=answer: answer)
        monkeypatch.setattr(sys, "argv", ["audit", *argv])
        assert audit.main() == code
        assert said in capsys.readouterr().out


def test_a_package_s_ffmpeg_is_under_the_gpl_where_x264_is_beside_it() -> None:
    pin = Pin("x", "1", ())
    alone, beside = (Package(pin, "MIT", "", (), libraries) for libraries in (("libavcodec",), ("libavcodec", "libx264")))
    assert alone.carried == {"libavcodec": "LGPL-2.1-or-later"}
    assert set(beside.carried.values()) == {"GPL-2.0-or-later"}
