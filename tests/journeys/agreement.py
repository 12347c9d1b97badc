"""Whether a run over the wire and the same run on fakes come to the same, within what is measured with.

Both have the same parts, twin and seed; what differs is when things happened, and so what each sensor's noise was.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from math import hypot, sqrt
from pathlib import Path
from typing import Any

from cellctl.recipe import Recipe
from cellctl.records.summary import RunSummary
from cellctl.runner import RunRequest, run_once
from hal.config import CellConfig

SIGMAS = 4.0
"""Of the difference of two poses, each with the uncertainty that its own run states."""
TORQUE = 0.02
"""Of the target: two samples of the run-up, transducer noise."""
PRELOAD = 0.10
"""Friction of a pass is drawn anew for each pass (3 %), for three passes; neighbours act on each other."""
TEMPERATURE_K = 2.0
"""Noise of the thermocouples, and one look at the heat earlier or later."""


@dataclass(frozen=True, slots=True)
class Agreement:
    """Differences wire minus fake: pose in sigmas of the difference, torque of the target, preload of the fake's."""

    pose_sigmas: float
    torque: float
    preload: float
    temperature_k: float

    def wrong(self) -> Iterator[str]:
        """What is beyond its limit."""
        for name, limit in (
            ("pose_sigmas", SIGMAS),
            ("torque", TORQUE),
            ("preload", PRELOAD),
            ("temperature_k", TEMPERATURE_K),
        ):
            if not getattr(self, name) <= limit:
                yield f"{name} differs by {getattr(self, name):.3g} from the fake cell's (limit {limit:g})"


def agreement(
    recipe: Recipe, config: CellConfig, seed: int, serials: tuple[str, str], wire: RunSummary, truth: dict[str, Any]
) -> Agreement:
    """`wire` and its `truth` against the same run on the fakes of `config`, made here under virtual time.

    Raises ValueError where that one is not accepted.
    """
    folder = config.path.parent / "fake"
    request = RunRequest(
        recipe, config.on_fakes(), seed, Path(folder), keep="none", rotor_serial=serials[0], shaft_serial=serials[1]
    )
    fake = run_once(request)
    if fake.summary is None or fake.truth is None or fake.verdict != "accepted":
        raise ValueError(f"on fakes the run ends {fake.state}, {fake.verdict}: {fake.reasons}")
    return compared(wire, truth, fake.summary, fake.truth.as_dict())


def compared(wire: RunSummary, truth: dict[str, Any], fake: RunSummary, fake_truth: dict[str, Any]) -> Agreement:
    """Largest differences of two accepted runs of one recipe on the same parts."""
    assert wire.alignment and fake.alignment and wire.heat and fake.heat, "both are whole"
    theta = abs(truth["theta_error_deg"] - fake_truth["theta_error_deg"])
    place = hypot(truth["x_error_mm"] - fake_truth["x_error_mm"], truth["y_error_mm"] - fake_truth["y_error_mm"])
    pose = max(
        theta / _sigma(wire.alignment["sigma_theta_deg"], fake.alignment["sigma_theta_deg"]),
        place / (sqrt(2.0) * _sigma(wire.alignment["sigma_xy_mm"], fake.alignment["sigma_xy_mm"])),
    )
    ours, theirs = _torques(wire), _torques(fake)
    assert ours.keys() == theirs.keys(), "the same joints in the same stages"
    pairs = zip(truth["preload_n"], fake_truth["preload_n"], strict=True)
    return Agreement(
        pose_sigmas=pose,
        torque=max(abs(ours[key] - theirs[key]) / theirs[key] for key in ours),
        preload=max(abs(a - b) / b for a, b in pairs),
        temperature_k=abs(wire.heat["reached_c"] - fake.heat["reached_c"]),
    )


def _sigma(one: float, other: float) -> float:
    return hypot(one, other)


def _torques(run: RunSummary) -> dict[tuple[int, str], float]:
    return {(joint["index"], joint["stage"]): float(joint["torque_nm"]) for joint in run.joints}
