"""Keys from the command line to the service that asks for them."""

from __future__ import annotations

import asyncio
from pathlib import Path

import httpx
import pytest

from cellctl.__main__ import main
from cellctl.app import TOKEN_FILE, Service, serve
from cellctl.service_rules import Settings
from cellctl.workplace import open_workplace
from hal.clock import QuickenedLoop


@pytest.fixture
def cell(tmp_path: Path, root: Path) -> Path:
    """A cell of fakes whose sign-in is by keys."""
    text = (root / "deploy/cell.fake.toml").read_text(encoding="utf-8")
    text = text.replace('mode = "demo"', 'mode = "keys"\nkeys = "keys.json"')
    text = text.replace('file = "calibration', f'file = "{root}/deploy/calibration')
    path = tmp_path / "cell.toml"
    path.write_text(text, encoding="utf-8")
    return path


def test_a_key_is_shown_once(cell: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["keys", "add", "mes-1", "--role", "mes", "--cell", str(cell)]) == 0
    key = capsys.readouterr().out.strip()
    assert len(key) >= 43
    assert main(["keys", "list", "--cell", str(cell)]) == 0
    told = capsys.readouterr().out
    assert told.split() == ["mes-1", "mes"]
    assert main(["keys", "remove", "mes-1", "--cell", str(cell)]) == 0
    capsys.readouterr()
    assert main(["keys", "list", "--cell", str(cell)]) == 0
    assert capsys.readouterr().out == ""


@pytest.mark.parametrize("name", ["two words", "", "x" * 65])
def test_a_name_that_is_none(cell: Path, capsys: pytest.CaptureFixture[str], name: str) -> None:
    assert main(["keys", "add", name, "--role", "mes", "--cell", str(cell)]) == 2
    assert "letters, digits" in capsys.readouterr().err
    assert not cell.with_name("keys.json").exists()


def test_a_cell_with_another_sign_in_has_no_keys(root: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["keys", "list", "--cell", str(root / "deploy/cell.fake.toml")]) == 2
    assert "auth.mode" in capsys.readouterr().err


@pytest.mark.parametrize("auth", ['mode = "keys"', 'mode = "demo"\nkeys = "keys.json"'])
def test_mode_and_file_belong_together(cell: Path, capsys: pytest.CaptureFixture[str], auth: str) -> None:
    cell.write_text(cell.read_text(encoding="utf-8").replace('mode = "keys"\nkeys = "keys.json"', auth))
    assert main(["keys", "list", "--cell", str(cell)]) == 2
    assert "keys names a file of keys" in capsys.readouterr().err


def test_without_a_file_of_keys_nothing_is_served(
    tmp_path: Path, cell: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["serve", "--cell", str(cell), "--port", "0", "--data", str(tmp_path / "data")]) == 2
    assert "keys.json" in capsys.readouterr().err


def test_the_service_lets_keys_in_and_makes_no_token(
    tmp_path: Path, root: Path, cell: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    main(["keys", "add", "screen", "--role", "viewer", "--cell", str(cell)])
    key = capsys.readouterr().out.strip()
    codes: list[int] = []

    async def during(service: Service) -> None:
        assert service.token == ""
        async with httpx.AsyncClient(base_url=service.url, timeout=None) as client:
            for token in (key, "", "admin"):
                headers = {"Authorization": f"Bearer {token}"} if token else {}
                answer = await client.get("/api/v1/cell", headers=headers)
                codes.append(answer.status_code)
                assert token != key or answer.json()["simulated"]

    settings = Settings(cell=cell, data=tmp_path / "data", recipes=root / "recipes", port=0)
    with asyncio.Runner(loop_factory=lambda: QuickenedLoop(1.0)) as runner:
        runner.run(serve(settings, open_workplace, during=during))
    assert codes == [200, 401, 401]
    assert not (tmp_path / "data" / TOKEN_FILE).exists()
    assert main(["demo", "--once", "--cell", str(cell), "--port", "0", "--data", str(tmp_path / "data")]) == 2
    assert "auth.mode" in capsys.readouterr().err
