"""What does not fit is told with its place before anything is started."""

from __future__ import annotations

import socket
from pathlib import Path

import pytest

from cellctl.__main__ import main


@pytest.mark.parametrize(
    ("options", "told"),
    [
        (("--host", "0.0.0.0"), "--host"),
        (("--speed", "0"), "--speed"),
        (("--speed", "nan"), "--speed"),
        (("--recipes", "tests"), "no recipe here"),
        (("--cell", "deploy/calibration.fake.toml"), "calibration.fake.toml"),
        (("--cell", "nowhere.toml"), "nowhere.toml"),
    ],
)
def test_wrong_settings(
    tmp_path: Path, root: Path, capsys: pytest.CaptureFixture[str], options: tuple[str, ...], told: str
) -> None:
    cell = str(root / "deploy/cell.fake.toml")
    assert main(["serve", "--cell", cell, "--port", "0", "--data", str(tmp_path), *options]) == 2
    assert told in capsys.readouterr().err


def test_a_port_that_is_taken(tmp_path: Path, root: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = str(taken.getsockname()[1])
        cell = str(root / "deploy/cell.fake.toml")
        assert main(["serve", "--cell", cell, "--port", port, "--data", str(tmp_path)]) == 2
    assert f"port {port} cannot be used" in capsys.readouterr().err


def test_the_demo_takes_the_same_options(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["demo", "--once", "--host", "10.0.0.1", "--data", str(tmp_path)]) == 2
    assert "--host" in capsys.readouterr().err


def test_a_clock_of_real_devices_is_not_quickened(
    tmp_path: Path, root: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    cell = str(root / "deploy/cell.wire.toml")
    assert main(["serve", "--cell", cell, "--port", "0", "--data", str(tmp_path), "--speed", "2"]) == 2
    assert "--speed" in capsys.readouterr().err


@pytest.mark.parametrize("wrong", ["--cell", "--recipe"])
def test_what_cannot_be_simulated_is_told(root: Path, capsys: pytest.CaptureFixture[str], wrong: str) -> None:
    files = {"--cell": str(root / "deploy/cell.wire.toml"), "--recipe": str(root / "recipes/lpt_shaft_36.toml")}
    given = files | {wrong: "nowhere.toml"}
    assert main(["simulate", *(part for pair in given.items() for part in pair)]) == 2
    assert "nowhere.toml" in capsys.readouterr().err
