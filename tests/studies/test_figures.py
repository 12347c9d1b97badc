"""Results in docs/figures: where they come from, one entry a command, the table beside them."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from cellctl.studies.figures import add_figure, commit_of, provenance, table

ROOT = Path(__file__).parents[2]


def entry(command: str, succeeded: int) -> dict[str, Any]:
    return provenance(command.split(), ROOT) | {
        "pose": "by sight",
        "runs": 10,
        "succeeded": succeeded,
        "rate": succeeded / 10,
        "interval95": [0.25, 0.75],
        "inserted_rate": 1.0,
        "force_ok_rate": succeeded / 10,
        "refused": 0,
        "peak_bolt_n": {"max": 12.0, "p95": 9.0},
        "failures": [{"seed": 7, "reason": "a stud met 12.0 N (limit 10 N)"}],
        "cpu_s": 31.0,
    }


def test_a_result_replaces_the_earlier_one_of_its_command(tmp_path: Path) -> None:
    path = tmp_path / "figures" / "study_dock.json"
    add_figure(path, entry("cellctl study dock --runs 10 --seed 2", 4))
    add_figure(path, entry("cellctl study dock --runs 10 --seed 1", 5))
    add_figure(path, entry("cellctl study dock --runs 10 --seed 2", 6))
    entries = json.loads(path.read_text())
    assert [(one["command"][-1], one["succeeded"]) for one in entries] == [("1", 5), ("2", 6)]
    text = path.with_suffix(".md").read_text()
    assert text == table(entries)
    assert "| `cellctl study dock --runs 10 --seed 2` | 10 | 6 (60.0 %) | 25.0 to 75.0 % |" in text
    assert "* seed 7: a stud met 12.0 N (limit 10 N)" in text
    assert "3.1 s of one core a dock" in text


def test_a_result_names_machine_and_commit() -> None:
    made = provenance(["cellctl", "study"], ROOT)
    assert made["command"] == "cellctl study"
    assert made["machine"]["cores"] >= 1
    assert made["machine"]["cpu"]
    assert made["commit"]


def test_without_a_repository_the_commit_is_unknown(tmp_path: Path) -> None:
    assert commit_of(tmp_path) == "unknown"


def test_a_file_that_holds_something_else_stays_as_it_is(tmp_path: Path) -> None:
    path = tmp_path / "other.json"
    path.write_text('{"a": 1}')
    with pytest.raises(ValueError, match="not a list of results"):
        add_figure(path, entry("cellctl", 1))
    assert path.read_text() == '{"a": 1}'


def test_the_figures_of_the_house_agree_with_their_table() -> None:
    path = ROOT / "docs" / "figures" / "study_dock.json"
    entries = json.loads(path.read_text())
    assert path.with_suffix(".md").read_text() == table(entries)
    for one in entries:
        assert one["runs"] == one["succeeded"] + len(one["failures"])
        assert not one["commit"].endswith("+")
