"""The fault files that come with the recipes: all readable, every device in one, each with its expected end."""

from __future__ import annotations

from pathlib import Path

import pytest

from hal.entries import Devices
from hal.fake.faults import load_faults

FILES = sorted((Path(__file__).parents[3] / "recipes" / "faults").glob("*.toml"))


@pytest.mark.parametrize("path", FILES, ids=lambda path: str(path.stem))
def test_each_says_what_goes_wrong_and_how_the_run_must_end(path: Path) -> None:
    book = load_faults(path)
    assert book.expect is not None
    assert path.read_text(encoding="utf-8").startswith("# "), "says what happens, for people"
    ends_well = book.expect.verdict == "accepted"
    assert ends_well == (book.expect.reason == ""), "a run that ends badly has a reason, a good one has none"
    assert book.expect.state == "Complete" or book.expect.verdict == "held"
    assert bool(book.faults) == (path.stem != "nothing")


def test_every_device_is_in_one_of_at_least_twenty_four() -> None:
    assert len(FILES) >= 24
    named = {fault.device for path in FILES for fault in load_faults(path).faults}
    assert named == set(Devices.model_fields)
