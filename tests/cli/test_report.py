import json
from pathlib import Path

import pytest

from hal.clock import run_virtual
from tests.cli.shell import cellctl
from tests.records.test_store import stored


def test_from_the_data_folder_and_from_the_record_the_same(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    record = run_virtual(stored(tmp_path))
    one, other = tmp_path / "one.html", tmp_path / "other.html"
    assert cellctl("report", "run-1", "--data", str(tmp_path), "--out", str(one), "--json") == 0
    assert json.loads(capsys.readouterr().out) == {
        "report": str(one), "run_id": "run-1", "state": "Complete", "verdict": "accepted"
    }  # fmt: skip
    assert cellctl("report", str(record), "--out", str(other)) == 0
    assert one.read_text() == other.read_text()
    assert "accepted" in capsys.readouterr().out


def test_the_default_file_is_named_after_the_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    run_virtual(stored(tmp_path / "data"))
    monkeypatch.chdir(tmp_path)
    assert cellctl("report", "run-1") == 0
    assert (tmp_path / "run-1.html").exists()


def test_no_run_and_no_record(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert cellctl("report", "run-9", "--data", str(tmp_path), "--json") == 2
    assert json.loads(capsys.readouterr().out)["error"]["code"] == "unreadable"
    (tmp_path / "broken.zip").write_bytes(b"PK")
    assert cellctl("report", str(tmp_path / "broken.zip"), "--out", str(tmp_path / "x.html")) == 2
    assert not (tmp_path / "x.html").exists()
