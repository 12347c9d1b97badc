"""Numbers of the vision core's campaigns, one at a time: a word for the tally, and what is wrong or ""."""

from __future__ import annotations

import tempfile
from pathlib import Path

from tests.vision import flange_campaign, stud_campaign
from tests.vision.files import campaign as files_campaign
from tests.vision.fit import campaign as fits

SEED = 20_000
"""Nights begin beyond the seeds of the figures."""


def elements(number: int) -> tuple[str, str]:
    """A fresh set of every geometric element and zone against its reference in many digits."""
    bad = [tally for kind in (*fits.LEAST, *fits.ZONES) if not (tally := fits.run(kind, 1, SEED + number)).good]
    return ("good" if not bad else "bad"), "; ".join(
        f"{one.kind}: {one.worst} {one.beaten} {one.refused}" for one in bad
    )


def studs(number: int) -> tuple[str, str]:
    """A random joint's studs at each size in turn: all found, none invented."""
    tally = stud_campaign.Tally()
    stud_campaign.flange(SEED + number, stud_campaign.POINTS[number % 3], tally)
    wrong = [*tally.refused, *tally.missed, *(["a stud was invented"] if tally.invented else [])]
    return ("found" if not wrong else "otherwise"), "; ".join(wrong)


def flanges(number: int) -> tuple[str, str]:
    """A random scan of a flange with a scanner's artefacts: the pose or a refusal, never a wrong pose."""
    outcome = flange_campaign.scene(SEED, number)
    wrong = (
        f"{outcome.clocking_deg:.2f} deg of clocking, {outcome.tilt_deg:.2f} deg of tilt off" if outcome.wrong else ""
    )
    return outcome.code or "pose", wrong


def files(number: int) -> tuple[str, str]:
    """A file, fit or unfit, given to `cellctl measure`: the answer that it should get."""
    with tempfile.TemporaryDirectory() as folder:
        outcome = files_campaign.outcome(files_campaign.drawn(SEED, number), Path(folder))
    return outcome.word, f"{outcome.what}: {outcome.fault}" if outcome.fault else ""
