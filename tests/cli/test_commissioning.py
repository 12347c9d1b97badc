"""The commands of a technician: exit codes, one JSON document, and refusals that say why."""

from __future__ import annotations

import io
import json
from pathlib import Path

import pytest

from cellctl.__main__ import main
from cellctl.cli import devices

FAKE, WIRE = "deploy/cell.fake.toml", "deploy/cell.wire.toml"


def test_devices_of_a_fake_cell(root: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["devices", "--cell", str(root / FAKE), "--json"]) == 0
    told = json.loads(capsys.readouterr().out)["devices"]
    assert len(told) == 25
    assert {one["error"] for one in told} == {""}
    jack = next(one for one in told if one["name"] == "jack")
    assert jack["identity"]["serial"] == "jack-1"
    assert jack["values"]["position_mm"] == 0.0


def test_devices_as_a_table(root: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["devices", "--cell", str(root / FAKE)]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].split()[:4] == ["device", "kind", "address", "identity"]
    assert lines[-1] == "25 of 25 devices answer"
    assert any(line.startswith("jack_force") and " N" in line for line in lines)


def test_devices_that_are_not_there(root: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The scanner's folder alone is of a kind that needs no port: everything else of this cell is fake."""
    text = (root / FAKE).read_text(encoding="utf-8")
    text = text.replace('scanner = { kind = "fake" }', 'scanner = { kind = "file_drop", folder = "nowhere" }')
    cell = tmp_path / "cell.toml"
    cell.write_text(text.replace('"calibration.fake.toml"', f'"{root}/deploy/calibration.fake.toml"'), encoding="utf-8")
    assert main(["devices", "--cell", str(cell)]) == 3
    out = capsys.readouterr().out
    assert "24 of 25 devices answer" in out
    assert "FAILED" in next(line for line in out.splitlines() if line.startswith("scanner"))


def test_failures_stand_in_the_table_beside_what_is_known() -> None:
    lines = devices.table(
        (devices.Found("jack", "canopen", "CAN can0 node 3", error="no answer", code="device_timeout"),)
    )
    assert "FAILED no answer" in lines
    assert "0 of 1 devices answer" in lines


@pytest.mark.parametrize("options", [("--watch", "1", "--json"), ("--watch", "0"), ("--watch", "nan")])
def test_a_watch_that_makes_no_sense(root: Path, capsys: pytest.CaptureFixture[str], options: tuple[str, ...]) -> None:
    assert main(["devices", "--cell", str(root / FAKE), *options]) == 2
    assert "--watch" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "code", "told"),
    [
        (("stage_x", "--to", "1", "--yes"), 3, "stage_x: is not homed"),
        (("stage_x", "--home", "--yes"), 3, "jack is not proven"),
        (("stage_x", "--to", "nan", "--yes"), 2, "--to"),
        (("stage_x", "--by", "1", "--speed", "-1", "--yes"), 2, "--speed"),
        (("stage_x", "--by", "1"), 2, "--yes"),
    ],
)
def test_a_jog_that_is_refused(
    root: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    words: tuple[str, ...],
    code: int,
    told: str,
) -> None:
    monkeypatch.setattr("sys.stdin", io.StringIO())
    assert main(["jog", *words, "--cell", str(root / FAKE), "--json"]) == code
    answer = capsys.readouterr()
    assert told in answer.err
    assert told in json.loads(answer.out)["error"]["reason"]


def test_a_jog_without_a_cell_file(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["jog", "jack", "--home", "--yes", "--cell", "nowhere.toml"]) == 2
    assert "nowhere.toml" in capsys.readouterr().err


def test_an_axis_that_no_cell_has() -> None:
    with pytest.raises(SystemExit, match="2"):
        main(["jog", "elevator", "--home", "--cell", "nowhere.toml"])


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (("gun_a",), "--listen"),
        (("lift", "--ask"), "on no bus"),
        (("scanner", "--ask"), "a folder is no bus"),
        (("gun_a", "--ask", "--seconds", "0"), "--seconds"),
        (("gun_a", "--listen", "here"), "is no port"),
    ],
)
def test_a_capture_that_cannot_be(
    root: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], words: tuple[str, ...], told: str
) -> None:
    out = str(tmp_path / "out.jsonl")
    assert main(["capture", *words, "--cell", str(root / WIRE), "-o", out]) == 2
    assert told in capsys.readouterr().err
