"""An interference fit without heat: refused, and forced past that it ends on the seating force."""

from __future__ import annotations

from cellctl.recipe import Recipe
from tests.journeys.twin_runs import assembled, small_recipe, told, twin_cell


def cold_recipe(*, draw_in: bool = False) -> Recipe:
    recipe = small_recipe()
    return recipe.model_copy(update={"heat": recipe.heat.model_copy(update={"enabled": False, "draw_in": draw_in})})


def test_it_is_refused_before_anything_moves() -> None:
    outcome = assembled(cold_recipe(), twin_cell())
    assert (outcome.state, outcome.verdict) == ("Stopped", "held")
    assert "cold_interference" in outcome.reasons[0]
    assert not outcome.truth.inserted


def test_forced_past_the_check_it_is_held_on_the_seating_force() -> None:
    outcome = assembled(cold_recipe(), twin_cell(), forced=("cold_interference",))
    assert (outcome.state, outcome.verdict) == ("Held", "held"), told(outcome)
    assert "of seating force" in outcome.reasons[0]
    assert outcome.truth.inserted
    assert outcome.truth.seating_gap_mm > 1.0


def test_nuts_that_may_draw_it_in_close_it() -> None:
    outcome = assembled(cold_recipe(draw_in=True), twin_cell())
    assert outcome.verdict == "accepted", told(outcome)
    assert outcome.truth.good
    assert outcome.truth.seating_gap_mm < 0.05
