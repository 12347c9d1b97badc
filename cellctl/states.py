"""Cell states, commands and the table of transitions between them: data and two functions.

PackML, ISA-TR88.00.02: 17 states. Hold from Starting, Suspending, Suspended, Unsuspending and Unholding follows
OPC 30050, table of the PackMLExecuteStateMachineType.
"""

from __future__ import annotations

from collections.abc import Mapping
from enum import StrEnum
from types import MappingProxyType


class State(StrEnum):
    """A PackML state. Names ending in -ing are left by themselves, the others wait for a command."""

    CLEARING = "Clearing"
    STOPPED = "Stopped"
    STARTING = "Starting"
    IDLE = "Idle"
    SUSPENDED = "Suspended"
    EXECUTE = "Execute"
    STOPPING = "Stopping"
    ABORTING = "Aborting"
    ABORTED = "Aborted"
    HOLDING = "Holding"
    HELD = "Held"
    UNHOLDING = "Unholding"
    SUSPENDING = "Suspending"
    UNSUSPENDING = "Unsuspending"
    RESETTING = "Resetting"
    COMPLETING = "Completing"
    COMPLETE = "Complete"


class Command(StrEnum):
    """What may be asked of the cell."""

    RESET = "reset"
    START = "start"
    HOLD = "hold"
    UNHOLD = "unhold"
    SUSPEND = "suspend"
    UNSUSPEND = "unsuspend"
    STOP = "stop"
    ABORT = "abort"
    CLEAR = "clear"
    COMPLETE = "complete"


class Refused(Exception):
    """A command that the present state does not allow; `allowed` are those that it does."""

    def __init__(self, command: Command, state: State, allowed: tuple[Command, ...]) -> None:
        super().__init__(f"{command} is not allowed in {state}")
        self.command = command
        self.state = state
        self.allowed = allowed


_UNSTOPPABLE = {State.STOPPING, State.STOPPED, State.ABORTING, State.ABORTED, State.CLEARING}
_HOLDABLE = (
    State.EXECUTE,
    State.STARTING,
    State.SUSPENDING,
    State.SUSPENDED,
    State.UNSUSPENDING,
    State.UNHOLDING,
)

ON_COMMAND: Mapping[tuple[State, Command], State] = MappingProxyType(
    {
        (State.STOPPED, Command.RESET): State.RESETTING,
        (State.COMPLETE, Command.RESET): State.RESETTING,
        (State.IDLE, Command.START): State.STARTING,
        (State.HELD, Command.UNHOLD): State.UNHOLDING,
        (State.EXECUTE, Command.SUSPEND): State.SUSPENDING,
        (State.SUSPENDED, Command.UNSUSPEND): State.UNSUSPENDING,
        (State.EXECUTE, Command.COMPLETE): State.COMPLETING,
        (State.ABORTED, Command.CLEAR): State.CLEARING,
    }
    | {(state, Command.HOLD): State.HOLDING for state in _HOLDABLE}
    | {(state, Command.STOP): State.STOPPING for state in State if state not in _UNSTOPPABLE}
    | {(state, Command.ABORT): State.ABORTING for state in State if state not in (State.ABORTING, State.ABORTED)}
)
"""Where a command leads."""

ON_DONE: Mapping[State, State] = MappingProxyType(
    {
        State.CLEARING: State.STOPPED,
        State.STARTING: State.EXECUTE,
        State.EXECUTE: State.COMPLETING,
        State.STOPPING: State.STOPPED,
        State.ABORTING: State.ABORTED,
        State.HOLDING: State.HELD,
        State.UNHOLDING: State.EXECUTE,
        State.SUSPENDING: State.SUSPENDED,
        State.UNSUSPENDING: State.EXECUTE,
        State.RESETTING: State.IDLE,
        State.COMPLETING: State.COMPLETE,
    }
)
"""Where an acting state leads once what it does is done."""


def allowed_commands(state: State) -> tuple[Command, ...]:
    """The commands that `state` allows, in the order of `Command`."""
    return tuple(command for command in Command if (state, command) in ON_COMMAND)


def after(state: State, command: Command) -> State:
    """The state that `command` leads to. Raises Refused where `state` does not allow it."""
    try:
        return ON_COMMAND[state, command]
    except KeyError:
        raise Refused(command, state, allowed_commands(state)) from None
