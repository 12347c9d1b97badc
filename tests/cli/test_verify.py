import json
from pathlib import Path

import pytest

from hal.clock import run_virtual
from tests.cli.shell import cellctl
from tests.records.test_store import stored


@pytest.fixture
def record(tmp_path: Path) -> Path:
    return run_virtual(stored(tmp_path))


def test_with_the_cells_key_it_is_authentic(record: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    key = str(tmp_path / "keys" / "cell_ed25519.pub")
    assert cellctl("verify", str(record), "--key", key) == 0
    assert capsys.readouterr().out.startswith("authentic: run run-1")
    assert cellctl("verify", str(record), "--key", key, "--json") == 0
    assert json.loads(capsys.readouterr().out)["status"] == "authentic"


def test_without_a_key_it_is_consistent_not_authenticated(record: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert cellctl("verify", str(record)) == 0
    assert "consistent, not authenticated" in capsys.readouterr().out


def test_another_cells_key_rejects_it(record: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run_virtual(stored(tmp_path / "other"))
    assert cellctl("verify", str(record), "--key", str(tmp_path / "other" / "keys" / "cell_ed25519.pub")) == 3
    assert "rejected" in capsys.readouterr().out


def test_a_truncated_record_is_rejected(record: Path, capsys: pytest.CaptureFixture[str]) -> None:
    record.write_bytes(record.read_bytes()[:-100])
    assert cellctl("verify", str(record), "--json") == 3
    assert json.loads(capsys.readouterr().out)["status"] == "rejected"


def test_what_cannot_be_read_is_bad_input(record: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert cellctl("verify", str(tmp_path / "none.zip"), "--json") == 2
    assert cellctl("verify", str(record), "--key", str(record)) == 2
    assert "cellctl verify" in capsys.readouterr().err
