"""The commands of a technician: exit codes, one JSON document, and refusals that say why."""

from __future__ import annotations

import asyncio
import io
import json
import os
from pathlib import Path

import pytest

from cellctl.__main__ import main
from cellctl.cli import devices, jog
from cellctl.cli.options import PARTS
from cellctl.commissioning.jog import Wish
from hal.clock import run_virtual
from hal.config import load_cell

FAKE, WIRE = "deploy/cell.fake.toml", "deploy/cell.wire.toml"


class Terminal(io.StringIO):
    """Somebody sits there."""

    def isatty(self) -> bool:
        return True


def test_devices_of_a_fake_cell(root: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["devices", "--cell", str(root / FAKE), "--json"]) == 0
    told = json.loads(capsys.readouterr().out)["devices"]
    assert len(told) == 26
    assert {one["error"] for one in told} == {""}
    jack = next(one for one in told if one["name"] == "jack")
    assert jack["identity"]["serial"] == "jack-1"
    assert jack["values"]["position_mm"] == 0.0


def test_devices_as_a_table(root: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["devices", "--cell", str(root / FAKE)]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].split()[:4] == ["device", "kind", "address", "identity"]
    assert lines[-1] == "26 of 26 devices answer"
    assert any(line.startswith("jack_force") and " N" in line for line in lines)


def test_devices_that_are_not_there(root: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The scanner's folder alone is of a kind that needs no port: everything else of this cell is fake."""
    text = (root / FAKE).read_text(encoding="utf-8")
    text = text.replace('scanner = { kind = "fake" }', 'scanner = { kind = "file_drop", folder = "nowhere" }')
    cell = tmp_path / "cell.toml"
    cell.write_text(text.replace('"calibration.fake.toml"', f'"{root}/deploy/calibration.fake.toml"'), encoding="utf-8")
    assert main(["devices", "--cell", str(cell)]) == 3
    out = capsys.readouterr().out
    assert "25 of 26 devices answer" in out
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


def test_a_watch_prints_again_and_again(root: Path, capsys: pytest.CaptureFixture[str]) -> None:
    async def case() -> None:
        watching = asyncio.create_task(devices.looked(load_cell(root / FAKE), PARTS, 10.0))
        await asyncio.sleep(35.0)
        watching.cancel()
        await asyncio.gather(watching, return_exceptions=True)

    run_virtual(case())
    assert capsys.readouterr().out.count("26 of 26 devices answer") == 4


def test_a_jog_says_what_it_does(root: Path) -> None:
    said: list[str] = []
    done = run_virtual(jog.jog(load_cell(root / FAKE), PARTS, Wish("gun_feed"), yes=True, say=said.append))
    assert done is not None
    assert done.end == "arrived"
    assert said[0] == "gun_feed: find its reference, from 0.000 mm"
    assert said[1] == "  0.000 mm, 0.000 mm/s"


@pytest.mark.parametrize(
    ("typed", "meant"), [("y\n", True), ("yes\n", True), ("n\n", False), ("\n", False), ("", False)]
)
def test_only_yes_is_yes(monkeypatch: pytest.MonkeyPatch, typed: str, meant: bool) -> None:
    async def asked() -> bool:
        return await jog.agreed(asyncio.Event())

    ours, theirs = os.pipe()
    with os.fdopen(ours) as terminal, os.fdopen(theirs, "w") as person:
        monkeypatch.setattr("sys.stdin", terminal)
        person.write(typed)
        person.close()
        assert asyncio.run(asked()) is typed.startswith("y")


def test_who_ends_the_command_does_not_agree(monkeypatch: pytest.MonkeyPatch) -> None:
    async def asked() -> bool:
        halt = asyncio.Event()
        halt.set()
        return await jog.agreed(halt)

    ours, theirs = os.pipe()
    with os.fdopen(ours) as terminal, os.fdopen(theirs, "w"):
        monkeypatch.setattr("sys.stdin", terminal)
        assert asyncio.run(asked()) is False


def test_a_jog_that_nobody_wants(
    root: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    async def nobody(halt: asyncio.Event) -> bool:
        return False

    monkeypatch.setattr(jog, "agreed", nobody)
    monkeypatch.setattr("sys.stdin", Terminal())
    assert main(["jog", "gun_feed", "--home", "--cell", str(root / FAKE), "--json"]) == 3
    assert json.loads(capsys.readouterr().out) == {"axis": "gun_feed", "end": "declined"}


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
