"""The verdict from planted results: one wrong thing, one reason."""

from dataclasses import replace
from pathlib import Path

import pytest

from cellctl.recipe import load_recipe
from cellctl.steps.evaluate import evaluate
from cellctl.steps.results import Closure, HeatProof, Insertion, JointResult, Seating, Tightened
from hal.interfaces import Band

RECIPE = load_recipe(Path(__file__).parents[2] / "recipes" / "lpt_shaft_36.toml")
STAGES = [*(stage.name for stage in RECIPE.tighten.stages), "verify"]
INSERTION = Insertion(True, 396.0, 980.0, 980.0, 5.0, 0.4, None, "bounded_by_total", 1)
HEAT = HeatProof(65.0, 45.0, 1.0, 60.0, 42.0, 48.0, ())
SEATING = Seating(True, 400.0, (0.0, 0.0, 0.0), 210.0, 220.0, 4.0)
CLOSURE = Closure((0.001, 0.002, 0.0), 400.0)
JOINTS = tuple(
    JointResult(i, "a", stage, 10.0, 30.0, 10.0, 9.0, 11.0, Band.OK, Band.OK, 10.0, "ok", 100 * number + i, "", 1)
    for number, stage in enumerate(STAGES)
    for i in range(RECIPE.pattern.count)
)
AGAIN = replace(JOINTS[0], tightening_id=999)


def reasons(**changes: object) -> tuple[str, ...]:
    parts: dict[str, object] = {
        "insertion": INSERTION, "heat": HEAT, "seating": SEATING,
        "tightened": Tightened(JOINTS, 0.0, 1.0), "closure": CLOSURE,
    } | changes  # fmt: skip
    return evaluate(RECIPE, **parts).reasons  # type: ignore[arg-type]  # planted parts


def test_a_sound_joint_is_accepted() -> None:
    assert reasons() == ()


@pytest.mark.parametrize(
    ("changes", "word"),
    [
        ({"insertion": replace(INSERTION, peak_total_n=10.5)}, "insertion force"),
        ({"seating": replace(SEATING, entry_peak_n=11.0)}, "before the spigot"),
        ({"heat": None}, "not heated"),
        ({"heat": replace(HEAT, difference_k=50.0)}, "temperature difference"),
        ({"closure": replace(CLOSURE, gap_mm=(0.0, float("inf"), 0.0))}, "gap probe 2"),
        ({"tightened": Tightened(JOINTS[:-1], 0.0, 1.0)}, "joint 35 has 0 results in stage verify"),
        ({"tightened": Tightened((replace(JOINTS[0], tightening_id=1), *JOINTS[1:]), 0.0, 1.0)}, "tightening 1 of gun"),
        ({"tightened": Tightened((*JOINTS, AGAIN), 0.0, 1.0)}, "joint 0 has 2 results in stage snug"),
        ({"tightened": Tightened((replace(JOINTS[0], verdict="unknown"), *JOINTS[1:]), 0.0, 1.0)}, "is unknown"),
    ],
)
def test_one_wrong_thing_is_one_reason(changes: dict[str, object], word: str) -> None:
    found = reasons(**changes)
    assert len(found) == 1
    assert word in found[0]
