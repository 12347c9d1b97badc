"""Hundreds of files, fit and unfit: `python -m tests.vision.files.campaign --files 300 --seed 1 [--figures FILE]`.

Every file is drawn at random from its number and the seed, one case after the other, and given to `cellctl measure`.
Exit 0 where each got the answer that it should, 3 otherwise: a wrong pose, an invented feature, a refusal of a right
file, a crash, a hang.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from cellctl.studies.figures import provenance
from tests.vision.files.good import GOOD
from tests.vision.files.judge import File, TookTooLong, ask, fault_of
from tests.vision.files.others import OTHERS
from tests.vision.files.packing import Case
from tests.vision.files.poor import POOR
from tests.vision.files.scenes import recipe_text

ROOT = Path(__file__).parents[3]
CASES: tuple[Case, ...] = (*GOOD, *POOR, *OTHERS)


@dataclass(frozen=True, slots=True)
class Outcome:
    """One file: what it is, the word of the answer, and why that is wrong, "" where it is right."""

    what: str
    word: str
    fault: str


def drawn(seed: int, number: int) -> File:
    """The file of this number."""
    return CASES[number % len(CASES)](np.random.default_rng([seed, number]))


def outcome(file: File, folder: Path) -> Outcome:
    """Write the file and its recipe, and ask the command."""
    path, recipe = folder / f"cloud{file.suffix}", folder / "recipe.toml"
    path.write_bytes(file.data)
    recipe.write_text(recipe_text(file.part), encoding="utf-8")
    try:
        answer = ask(path, recipe, "shaft" if file.part.feature == "hole" else "rotor")
    except TookTooLong as hang:
        return Outcome(file.what, "hang", str(hang))
    except Exception as error:
        return Outcome(file.what, "crash", f"{type(error).__name__}: {error}")
    return Outcome(file.what, answer.word, fault_of(file, answer))


def main(words: Sequence[str] | None = None) -> int:
    """Run the campaign."""
    parser = argparse.ArgumentParser(prog="python -m tests.vision.files.campaign", description=__doc__)
    parser.add_argument("--files", type=int, default=300)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--figures", type=Path, help="file to write, as docs/figures/files.json")
    args = parser.parse_args(words)
    answers: Counter[str] = Counter()
    faults = []
    with tempfile.TemporaryDirectory() as folder:
        for number in range(args.files):
            one = outcome(drawn(args.seed, number), Path(folder))
            answers[one.word] += 1
            if one.fault:
                faults.append({"number": number, "what": one.what, "fault": one.fault})
                print(f"{number} {one.what}: {one.fault}", file=sys.stderr, flush=True)
    result = {"files": args.files, "answers": dict(sorted(answers.items())), "faults": faults}
    print(json.dumps(result, indent=1))
    if args.figures is not None:
        command = f"python -m tests.vision.files.campaign --files {args.files} --seed {args.seed}"
        entry = provenance([command], ROOT) | result
        args.figures.write_text(json.dumps(entry, indent=1) + "\n", encoding="utf-8")
    return 3 if faults else 0


if __name__ == "__main__":
    sys.exit(main())
