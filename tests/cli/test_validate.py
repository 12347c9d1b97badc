import json
import shutil
from pathlib import Path
from typing import Any

import pytest

from tests.cli.shell import ROOT, cellctl
from tests.test_recipe import lpt

CELL = ROOT / "deploy" / "cell.fake.toml"


def told(capsys: pytest.CaptureFixture[str], *words: str) -> tuple[int, dict[str, Any]]:
    code = cellctl("validate", *words, "--json")
    out = capsys.readouterr().out
    assert out.count("\n") == 1
    return code, json.loads(out)


def test_every_file_of_the_house_is_valid(capsys: pytest.CaptureFixture[str]) -> None:
    assemblies = [ROOT / "recipes" / f"{name}.toml" for name in ("lpt_shaft_36", "compressor_drum_24")]
    others = [ROOT / "recipes" / "flange_iso9409_50_4.toml", ROOT / "deploy" / "calibration.fake.toml", CELL]
    faults = sorted((ROOT / "recipes" / "faults").glob("*.toml"))
    code, document = told(capsys, *map(str, [*assemblies, *others, *faults]))
    assert [one for one in document["files"] if one["faults"]] == []
    assert code == 0
    kinds = [one["kind"] for one in document["files"]]
    assert kinds == ["recipe"] * 3 + ["calibration", "cell"] + ["faults"] * len(faults)
    assert cellctl("validate", "--cell", str(CELL), *map(str, assemblies)) == 0


def test_all_faults_of_a_recipe_with_place_limit_and_check(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "r.toml"
    path.write_text(lpt(("enabled = true", "enabled = false"), ("length_mm = 32.0", "length_mm = 20.0")))
    code, document = told(capsys, str(path))
    assert code == 2
    assert not document["valid"]
    faults = {fault["check"]: fault for fault in document["files"][0]["faults"]}
    assert set(faults) == {"cold_interference", "stud_length"}
    assert faults["stud_length"]["place"] == "r.toml.rotor.length_mm"
    assert faults["stud_length"]["unit"] == "mm"
    path.write_text(lpt(("count = 36", "count = 2"), ("soak_s = 60.0", "soak_s = -1.0")))
    assert cellctl("validate", str(path)) == 2
    out = capsys.readouterr().out
    assert "r.toml.pattern.count" in out
    assert "r.toml.heat.soak_s: Input should be greater than or equal to 0 (limit >= 0.0 s)" in out


def test_a_recipe_is_checked_against_the_cell_that_is_given(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "r.toml"
    path.write_text(lpt(("max_power_w = 3000.0", "max_power_w = 5000.0")))
    assert told(capsys, str(path))[0] == 0
    code, document = told(capsys, "--cell", str(CELL), str(path))
    assert code == 2
    assert [fault["check"] for fault in document["files"][1]["faults"]] == ["heater_power"]


def test_all_faults_of_a_cell_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    text = CELL.read_text().replace("safe_deadline_s = 0.5", "safe_deadline_s = -1.0\nbeside = 1")
    text = text.replace("rate_hz = 1000.0", 'rate_hz = "fast"').replace(
        "low = -15.0, high = 15.0", "low = 15.0, high = 15.0", 1
    )
    path = tmp_path / "cell.toml"
    path.write_text(text)
    code, document = told(capsys, str(path))
    places = [fault["place"] for fault in document["files"][0]["faults"]]
    assert code == 2
    assert places == [
        "cell.toml.cell.safe_deadline_s", "cell.toml.cell.beside", "cell.toml.devices.stage_x",
        "cell.toml.devices.jack_force.rate_hz",
    ]  # fmt: skip


def test_a_cell_files_calibration_and_overrides_are_looked_at(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "cell.toml"
    path.write_text(CELL.read_text() + "\n[twin.overrides]\nno_such_number = 1.0\n")
    code, document = told(capsys, str(path))
    assert code == 2
    places = [fault["place"] for fault in document["files"][0]["faults"]]
    assert places == ["cell.toml.calibration.file", "calibration.fake.toml", "cell.toml.twin.overrides.no_such_number"]
    shutil.copy(ROOT / "deploy" / "calibration.fake.toml", tmp_path)
    path.write_text(CELL.read_text() + "\n[twin.overrides]\nshaft_mass_kg = 90.0\n")
    assert told(capsys, str(path))[0] == 0


def test_all_faults_of_fault_and_calibration_files(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    faults, calibration = tmp_path / "f.toml", tmp_path / "c.toml"
    faults.write_text('[[fault]]\ndevice = "heater"\nkind = "unheard_of"\nphase = "lunch"\n[expect]\nstate = "Held"\n')
    text = (ROOT / "deploy" / "calibration.fake.toml").read_text()
    calibration.write_text(text.replace("sigma_gain = 0.005", "sigma_gain = -1.0").replace("gain = 1.0", "gain = nan"))
    code, document = told(capsys, str(faults), str(calibration))
    assert code == 2
    places = [[fault["place"] for fault in one["faults"]] for one in document["files"]]
    assert places[0] == ["f.toml.fault.0.kind", "f.toml.fault.0.phase", "f.toml.expect.verdict"]
    assert places[1] == ["c.toml.jack_force.gain", "c.toml.jack_force.sigma_gain"]


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"= broken", "not TOML"),
        (b"[other]\na = 1\n", "neither recipe"),
        (b"\xff\xfe", "cannot be read"),
        (None, "cannot be read"),
    ],
)
def test_what_is_none_of_these_files(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], content: bytes | None, said: str
) -> None:
    path = tmp_path / "x.toml"
    if content is not None:
        path.write_bytes(content)
    code, document = told(capsys, str(path))
    assert (code, document["files"][0]["kind"]) == (2, "unknown")
    assert said in document["files"][0]["faults"][0]["reason"]


def test_no_file_is_no_valid_file(capsys: pytest.CaptureFixture[str]) -> None:
    assert told(capsys)[0] == 2


def test_the_schema_is_printed(capsys: pytest.CaptureFixture[str]) -> None:
    assert cellctl("validate", "--schema") == 0
    assert capsys.readouterr().out == (ROOT / "recipes" / "recipe.schema.json").read_text()
