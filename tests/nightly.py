"""Long campaigns: `python -m tests.nightly --minutes 60 [--only NAME] [--figures FOLDER]`.

One number after the other of each campaign in turn until the time is up. What came of them is added to
`FOLDER/nightly_NAME.json` with commit and machine, and the next night goes on where this one stopped. A number alone
repeats its run. Exit 0 where nothing failed, 3 otherwise.
"""

from __future__ import annotations

import argparse
import json
import logging
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from functools import partial
from pathlib import Path
from random import Random
from typing import Any

from cellctl.recipe import load_recipe
from cellctl.studies.figures import provenance
from hal.config import Level, load_cell
from hal.fake.fault_file import load_faults
from tests.dead.processes import moment
from tests.dead.races import raced
from tests.journeys.stops import stopped
from tests.journeys.swarm import broken, random_faults, wrong_truth
from tests.journeys.twin_runs import (
    CELL,
    FAULTS,
    RECIPE,
    ROOT,
    SMALL,
    RememberedJobs,
    assembled,
    small_recipe,
    told,
    twin_cell,
    with_twin,
)
from tests.vision import nights
from tests.wire.campaign import numbered

SWARM_SEEDS = 4
"""Twins that the swarm is spread over: few, so that their clouds are computed once."""
RACES = 100
"""Trips of one number."""


@dataclass(frozen=True, slots=True)
class Result:
    """What one number came to: a word for the tally, and what is wrong with it, empty where nothing is."""

    word: str
    wrong: str = ""


Campaign = Callable[[int], Result]


@dataclass(slots=True)
class Range:
    """Consecutive numbers of one campaign on one night."""

    first: int
    next: int
    tally: dict[str, int] = field(default_factory=dict)
    failures: list[dict[str, Any]] = field(default_factory=list)

    def take(self, campaign: Campaign) -> None:
        """Run the next number. An error is a failure, never the end of the night."""
        number = self.next
        try:
            result = campaign(number)
        except Exception as error:
            result = Result("error", f"{type(error).__name__}: {error}")
        self.next += 1
        self.tally[result.word] = self.tally.get(result.word, 0) + 1
        if result.wrong:
            self.failures.append({"number": number, "reason": result.wrong[:600]})


def fault_files(number: int) -> Result:
    """Each file under recipes/faults/ on the whole joint, as the cell file has it."""
    files = sorted(FAULTS.glob("*.toml"))
    path = files[number % len(files)]
    file = load_faults(path)
    expect = file.expect
    assert expect is not None
    outcome = assembled(load_recipe(RECIPE), load_cell(CELL), seed=1 + number // len(files), faults=file.faults)
    same = (outcome.state, outcome.verdict) == (expect.state, expect.verdict)
    wrong = [] if same and expect.reason in "; ".join(outcome.reasons) else [f"{path.stem} ends {told(outcome)}"]
    return Result("as expected" if not wrong else "otherwise", "; ".join([*wrong, *broken(outcome)]))


def seeds(level: Level, number: int) -> Result:
    """The whole joint on another twin, nothing planted."""
    outcome = assembled(load_recipe(RECIPE), with_twin(load_cell(CELL), level=level), seed=10_000 + number)
    return Result(outcome.verdict, "; ".join(broken(outcome)))


def swarm(jobs: RememberedJobs, number: int) -> Result:
    """Random faults on the small joint."""
    draw = Random(number)
    faults = random_faults(draw, SMALL)
    outcome = assembled(small_recipe(), twin_cell(), seed=1 + number % SWARM_SEEDS, faults=faults, jobs=jobs)
    wrong = broken(outcome)
    return Result(outcome.verdict, f"{faults}: {'; '.join(wrong)}" if wrong else "")


def truth(number: int) -> Result:
    """A twin whose truth differs from what the controller believes, on the small joint."""
    overrides = wrong_truth(Random(number))
    outcome = assembled(small_recipe(), twin_cell(overrides), seed=1 + number)
    wrong = broken(outcome)
    return Result(outcome.verdict, f"{overrides}: {'; '.join(wrong)}" if wrong else "")


def stops(jobs: RememberedJobs, number: int) -> Result:
    """The whole cell stopped at a random instant."""
    return Result(stopped(Random(number), jobs).rsplit(" ", 1)[-1])


def races(number: int) -> Result:
    """Trips of the guard, raced with motion commands."""
    wrong = raced(number, RACES)
    return Result(f"{RACES} trips, none undone" if not wrong else "undone", wrong)


def dead(number: int) -> Result:
    """Controller or guard killed or stopped at a random moment, as real processes."""
    return Result(*moment(number))


def wires(number: int) -> Result:
    """A fault on one of the buses at a random moment."""
    return Result(*numbered(number))


def seen(numbers: Callable[[int], tuple[str, str]], number: int) -> Result:
    """A number of one of the vision core's campaigns."""
    return Result(*numbers(number))


def campaigns() -> dict[str, Campaign]:
    """All of them by name."""
    jobs = RememberedJobs()
    return {
        "faults": fault_files,
        "nominal": partial(seeds, "nominal"),
        "hostile": partial(seeds, "hostile"),
        "swarm": partial(swarm, jobs),
        "truth": truth,
        "stops": partial(stops, jobs),
        "races": races,
        "dead": dead,
        "wires": wires,
        "elements": partial(seen, nights.elements),
        "studs": partial(seen, nights.studs),
        "flanges": partial(seen, nights.flanges),
        "files": partial(seen, nights.files),
    }


def night(
    chosen: Mapping[str, Campaign], folder: Path, minutes: float, *, clock: Callable[[], float] = time.monotonic
) -> dict[str, Range]:
    """Every campaign in turn until the time is up; at least one number of each."""
    end_s = clock() + 60.0 * minutes
    entry = provenance(["python", "-m", "tests.nightly"], ROOT)
    before = {name: _ranges(folder / f"nightly_{name}.json") for name in chosen}
    ranges = {name: Range(_next(earlier), _next(earlier)) for name, earlier in before.items()}
    while True:
        for name, campaign in chosen.items():
            ranges[name].take(campaign)
            _write(folder / f"nightly_{name}.json", [*before[name], entry | asdict(ranges[name])])
            if clock() >= end_s and all(done.next > done.first for done in ranges.values()):
                return ranges


def _ranges(path: Path) -> list[dict[str, Any]]:
    found = json.loads(path.read_text(encoding="utf-8")) if path.exists() else []
    if not isinstance(found, list):
        raise ValueError(f"{path} holds something else")
    return found


def _next(earlier: Sequence[Mapping[str, Any]]) -> int:
    return max((int(one["next"]) for one in earlier), default=0)


def _write(path: Path, ranges: Sequence[Mapping[str, Any]]) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(ranges, indent=1) + "\n", encoding="utf-8")


def main(argv: Sequence[str] | None = None) -> int:
    """The command."""
    known = campaigns()
    parser = argparse.ArgumentParser(prog="python -m tests.nightly", description=__doc__)
    parser.add_argument("--minutes", type=float, default=60.0)
    parser.add_argument("--only", action="append", choices=sorted(known))
    parser.add_argument("--figures", type=Path, default=ROOT / "docs" / "figures")
    args = parser.parse_args(argv)
    logging.disable(logging.CRITICAL)
    chosen = {name: known[name] for name in args.only or known}
    done = night(chosen, args.figures, args.minutes)
    for name, numbers in done.items():
        print(f"{name} {numbers.first} to {numbers.next - 1}: {numbers.tally}")
        for failure in numbers.failures:
            print(f"  {failure['number']}: {failure['reason']}")
    return 3 if any(numbers.failures for numbers in done.values()) else 0


if __name__ == "__main__":
    sys.exit(main())
