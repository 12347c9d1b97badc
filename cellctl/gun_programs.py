"""What a tightening controller must be programmed with for a recipe: it can only run parameter sets of its own."""

from __future__ import annotations

from cellctl.recipe import Tighten
from cellctl.steps.engage import START_RPM
from cellctl.steps.joint import stage_program, verify_program
from hal.fake.wire.gun_memory import Program, TurnProgram

TURN_DEG = 360.0
"""Smaller angles are turned slowly."""


def programs_of(recipe: Tighten) -> tuple[Program, ...]:
    """Every program and turn of a recipe, each once, in the order of their parameter sets."""
    engage = recipe.engage
    stages = [stage_program(recipe, stage) for stage in recipe.stages]
    turns = [
        (-engage.reverse_deg, recipe.thread_start_torque_nm),
        (engage.start_turns_deg, recipe.thread_start_torque_nm),
        (engage.turn_step_deg, engage.turn_torque_nm),
    ]
    searched = [
        TurnProgram(angle, engage.turn_speed_rpm if abs(angle) < TURN_DEG else START_RPM, torque)
        for angle, torque in turns
    ]
    return tuple(dict.fromkeys([*stages, verify_program(recipe), *searched]))
