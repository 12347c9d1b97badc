"""The table against the standard's own drawing, and its properties."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cellctl.states import ON_COMMAND, ON_DONE, Command, Refused, State, after, allowed_commands

STATES = st.sampled_from(list(State))
COMMANDS = st.sampled_from(list(Command))


def test_the_standard_has_17_states() -> None:
    assert len(State) == 17


@pytest.mark.parametrize(
    ("state", "allowed"),
    [
        (State.STOPPED, {"reset", "abort"}),
        (State.IDLE, {"start", "stop", "abort"}),
        (State.EXECUTE, {"hold", "suspend", "stop", "abort", "complete"}),
        (State.HELD, {"unhold", "stop", "abort"}),
        (State.SUSPENDED, {"unsuspend", "hold", "stop", "abort"}),
        (State.COMPLETE, {"reset", "stop", "abort"}),
        (State.ABORTED, {"clear"}),
        (State.ABORTING, set()),
        (State.STOPPING, {"abort"}),
        (State.CLEARING, {"abort"}),
    ],
)
def test_allowed_commands(state: State, allowed: set[str]) -> None:
    assert {str(command) for command in allowed_commands(state)} == allowed


@given(STATES, COMMANDS)
def test_a_command_is_taken_or_refused_with_the_allowed_ones(state: State, command: Command) -> None:
    if command in allowed_commands(state):
        assert after(state, command) in State
    else:
        with pytest.raises(Refused) as caught:
            after(state, command)
        assert caught.value.allowed == allowed_commands(state)
        assert caught.value.state is state


@given(STATES, COMMANDS)
def test_a_command_leads_to_a_state_that_acts(state: State, command: Command) -> None:
    if (state, command) in ON_COMMAND:
        assert after(state, command) in ON_DONE


@given(STATES)
def test_every_state_that_does_not_abort_can_be_aborted(state: State) -> None:
    assert (Command.ABORT in allowed_commands(state)) == (state not in (State.ABORTING, State.ABORTED))


@given(STATES)
def test_from_every_state_the_cell_comes_back_to_idle(state: State) -> None:
    """Abort, clear and reset bring the cell back whatever happened."""
    for command in (Command.ABORT, Command.CLEAR, Command.RESET):
        if command in allowed_commands(state):
            state = after(state, command)
        state = ON_DONE.get(state, state)
        if command is Command.ABORT and state is not State.ABORTED:
            state = ON_DONE[after(state, Command.ABORT)]
    assert state is State.IDLE


def test_acting_states_are_those_with_an_end_of_their_own() -> None:
    acting = {state for state in State if state.endswith("ing")} | {State.EXECUTE}
    assert acting == set(ON_DONE)


def test_stop_and_abort_never_lead_back_into_execution() -> None:
    for state in State:
        for command in (Command.STOP, Command.ABORT):
            if command in allowed_commands(state):
                assert ON_DONE[after(state, command)] in (State.STOPPED, State.ABORTED)
