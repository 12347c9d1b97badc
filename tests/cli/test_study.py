"""`cellctl study dock`: its document, its exit codes, what it refuses."""

from __future__ import annotations

import argparse
import json
from typing import Any

import pytest

from cellctl.cli import study

DRAWN = ("--theta-sigma-deg", "0.2", "--xy-sigma-mm", "0.025")


def cellctl(*words: str) -> int:
    parser = argparse.ArgumentParser("cellctl")
    study.add_parser(parser.add_subparsers(required=True))
    args = parser.parse_args(("study", "dock", *words))
    code: int = args.run(args)
    return code


def test_one_document_with_everything_that_the_result_depends_on(capsys: pytest.CaptureFixture[str]) -> None:
    assert (
        cellctl("--runs", "3", "--seed", "1", *DRAWN, "--workers", "2", "--set", "friction_coefficient=0.2", "--json")
        == 0
    )
    captured = capsys.readouterr()
    document: dict[str, Any] = json.loads(captured.out)
    assert {"runs", "succeeded", "rate", "interval95", "inserted_rate", "force_ok_rate", "refused"} <= set(document)
    assert set(document["peak_total_n"]) == set(document["peak_bolt_n"]) == {"max", "p95"}
    assert document["runs"] == 3
    assert document["succeeded"] + len(document["failures"]) == 3
    assert document["failures"], "an angle error this wide fails now and then in three docks of these seeds"
    assert set(document["failures"][0]) == {"seed", "reason"}
    assert (document["pose"], document["seeds"], document["level"]) == ("drawn", [1, 3], "nominal")
    assert document["overrides"] == {"friction_coefficient": 0.2}
    assert "seeds 1 to 3" in captured.err


def test_people_get_text() -> None:
    document: dict[str, Any] = {
        "runs": 2,
        "succeeded": 1,
        "rate": 0.5,
        "interval95": [0.1, 0.9],
        "inserted_rate": 1.0,
        "force_ok_rate": 0.5,
        "refused": 0,
        "peak_bolt_n": {"max": 12.5, "p95": 12.5},
        "peak_total_n": {"max": 20.0, "p95": 20.0},
        "failures": [{"seed": 4, "reason": "a stud met 12.5 N (limit 10 N)"}],
    }
    text = study.as_text(document)
    assert "1 of 2 docks succeeded (50.0 %, 95 % interval 10.0 to 90.0 %)" in text
    assert "seed 4: a stud met 12.5 N" in text
    assert "more" not in text
    many = study.as_text(document | {"failures": 25 * document["failures"]})
    assert many.count("seed 4") == 10
    assert many.endswith("and 15 more; --json has all")


@pytest.mark.parametrize(
    ("words", "place"),
    [
        (("--runs", "0", *DRAWN), "--runs"),
        (("--runs", "2", "--theta-sigma-deg", "-1"), "--theta-sigma-deg"),
        (("--runs", "2", "--xy-sigma-mm", "nan"), "--xy-sigma-mm"),
        (("--runs", "2", *DRAWN, "--set", "no_such_number=1"), "no_such_number"),
        (("--runs", "2", *DRAWN, "--set", "friction_coefficient=much"), "friction_coefficient"),
        (("--runs", "2", "--points", "5"), "--points"),
        (("--runs", "2", *DRAWN, "--recipe", "missing.toml"), "missing.toml"),
    ],
)
def test_bad_input_is_refused_with_its_place(
    capsys: pytest.CaptureFixture[str], words: tuple[str, ...], place: str
) -> None:
    assert cellctl(*words, "--json") == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert place in captured.err
