"""One file of every case, fit and unfit, against what the command must say to it."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from tests.vision.files import campaign
from tests.vision.files.campaign import CASES, outcome
from tests.vision.files.packing import Case

SEED = 3


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.__name__)
def test_every_file_gets_its_answer(case: Case, tmp_path: Path) -> None:
    found = outcome(case(np.random.default_rng(SEED)), tmp_path)
    assert not found.fault, found


def test_the_campaign_counts_answers(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert campaign.main(["--files", "2", "--seed", "1", "--figures", str(tmp_path / "files.json")]) == 0
    entry = json.loads((tmp_path / "files.json").read_text(encoding="utf-8"))
    assert sum(entry["answers"].values()) == 2 and entry["faults"] == []
    assert json.loads(capsys.readouterr().out)["files"] == 2
