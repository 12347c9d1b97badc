"""One whole assembly, from an order over HTTP to a sealed record: what `make demo` does, on a faster clock."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from cellctl.__main__ import main


def test_the_demo_ends_with_an_accepted_joint_and_its_record(
    tmp_path: Path, root: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = (root / "deploy/cell.fake.toml").read_text(encoding="utf-8")
    cell = tmp_path / "cell.toml"
    cell.write_text(text.replace('level = "nominal"', 'level = "ideal"').replace("points = 500000", "points = 150000"))
    calibration = (root / "deploy/calibration.fake.toml").read_text(encoding="utf-8")
    (tmp_path / "calibration.fake.toml").write_text(calibration)
    data = tmp_path / "data"
    options = ["--once", "--speed", "1000", "--port", "0", "--order", "first-light", "--json"]
    code = main(["demo", "--cell", str(cell), "--data", str(data), *options])
    out, progress = capsys.readouterr()
    told = json.loads(out)
    assert (code, told["verdict"], told["reasons"]) == (0, "accepted", [])
    assert "tighten" in progress
    assert main(["verify", told["record"], "--key", str(data / "keys" / "cell_ed25519.pub"), "--json"]) == 0
    verified = json.loads(capsys.readouterr().out)
    assert told["run_id"] in json.dumps(verified)


def test_a_recipe_that_does_not_fit_is_told_with_its_limit(
    tmp_path: Path, root: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    options = ["--once", "--speed", "1000", "--port", "0", "--recipe", "wire_bench", "--data", str(tmp_path / "data")]
    assert main(["demo", "--cell", str(root / "deploy" / "cell.fake.toml"), *options]) == 2
    told = capsys.readouterr().err
    assert "422 recipe_unfit" in told
    assert "approach_speed_mm_s: 160.0 mm/s is faster than the axis (limit <= 20.0 mm/s)" in told
