"""The rules of stopping, under virtual time."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from random import Random

import pytest

from cellctl.controller import Controller
from cellctl.ports import Checkpoint, Progress, RunHeld
from cellctl.session import Outcome, RunEnd
from cellctl.states import Command, Refused, State
from hal.clock import run_virtual
from hal.errors import DeviceTimeout, SafetyOpen
from tests.doubles import DoubleCell, DoubleSession, event_log, five_phases, stubborn

DEADLINE_S = 0.5


def controller_on(cell: DoubleCell, ready: Callable[[], Awaitable[str]] | None = None) -> Controller:
    return Controller(cell, event_log(), safe_deadline_s=DEADLINE_S, ready=ready)


async def started(session: DoubleSession) -> Controller:
    controller = controller_on(session.cell)
    controller.request(Command.RESET)
    await controller.until(State.IDLE)
    controller.start(session)
    return controller


def now() -> float:
    return asyncio.get_running_loop().time()


async def no_task_is_left() -> None:
    await asyncio.sleep(0)
    assert asyncio.all_tasks() == {asyncio.current_task()}


def test_a_run_goes_from_idle_to_complete_and_is_closed_once() -> None:
    async def main() -> None:
        session = DoubleSession(DoubleCell(), five_phases)
        controller = await started(session)
        assert controller.state is State.STARTING
        await controller.until(State.COMPLETE)
        assert [end.ending for end in session.ends] == ["complete"]
        assert session.ends[0].outcome.verdict == "accepted"
        assert not session.open
        controller.request(Command.RESET)
        await controller.until(State.IDLE)
        assert controller.snapshot().run_id is None
        await no_task_is_left()

    run_virtual(main())


def test_commands_answer_at_once_while_a_step_runs() -> None:
    async def main() -> None:
        session = DoubleSession(DoubleCell(), five_phases)
        controller = await started(session)
        await controller.until(State.EXECUTE)
        asked = now()
        assert controller.request(Command.STOP) is State.STOPPING
        assert now() == asked
        await asyncio.sleep(0)
        await asyncio.sleep(0)
        assert session.cell.halted_at == [asked]
        await controller.until(State.STOPPED)
        assert [end.ending for end in session.ends] == ["stopped"]
        await no_task_is_left()

    run_virtual(main())


def test_hold_retreats_at_the_checkpoint_and_unhold_resumes() -> None:
    async def main() -> None:
        session = DoubleSession(DoubleCell(), five_phases)
        controller = await started(session)
        await controller.until(State.EXECUTE)
        assert controller.request(Command.HOLD) is State.HOLDING
        await controller.until(State.HELD)
        assert session.trail == ["scan", "retreat"]
        await asyncio.sleep(100)
        assert session.trail == ["scan", "retreat"]
        assert Command.UNHOLD in controller.allowed()
        assert controller.request(Command.UNHOLD) is State.UNHOLDING
        await controller.until(State.EXECUTE)
        assert session.trail == ["scan", "retreat", "resume"]
        await controller.until(State.COMPLETE)
        assert session.ends[0].outcome.verdict == "accepted"

    run_virtual(main())


def test_a_hold_during_unholding_pauses_again() -> None:
    async def main() -> None:
        session = DoubleSession(DoubleCell(), five_phases)
        controller = await started(session)
        await controller.until(State.EXECUTE)
        controller.request(Command.HOLD)
        await controller.until(State.HELD)
        controller.request(Command.UNHOLD)
        controller.request(Command.HOLD)
        await controller.until(State.HELD)
        assert session.trail == ["scan", "retreat", "resume", "retreat"]
        controller.request(Command.UNHOLD)
        await controller.until(State.COMPLETE)

    run_virtual(main())


def test_suspended_can_be_held_and_goes_on_from_there() -> None:
    async def main() -> None:
        session = DoubleSession(DoubleCell(), five_phases)
        controller = await started(session)
        await controller.until(State.EXECUTE)
        controller.request(Command.SUSPEND)
        await controller.until(State.SUSPENDED)
        assert controller.request(Command.HOLD) is State.HELD
        controller.request(Command.UNHOLD)
        await controller.until(State.EXECUTE)
        await controller.until(State.COMPLETE)

    run_virtual(main())


def test_a_hold_in_starting_holds_before_the_first_phase() -> None:
    async def main() -> None:
        session = DoubleSession(DoubleCell(), five_phases)
        controller = await started(session)
        controller.request(Command.HOLD)
        await controller.until(State.HELD)
        assert session.trail == []
        controller.request(Command.UNHOLD)
        await controller.until(State.COMPLETE)

    run_virtual(main())


def test_a_hold_after_the_last_checkpoint_still_holds() -> None:
    async def only_a_move(session: DoubleSession, checkpoint: Checkpoint, progress: Progress) -> Outcome:
        await session.cell.move("jack", 1.0)
        return Outcome("accepted")

    async def main() -> None:
        session = DoubleSession(DoubleCell(), only_a_move)
        controller = await started(session)
        await controller.until(State.EXECUTE)
        controller.request(Command.HOLD)
        await controller.until(State.HELD)
        assert session.open
        controller.request(Command.UNHOLD)
        await controller.until(State.COMPLETE)

    run_virtual(main())


def test_complete_ends_at_the_next_checkpoint_as_rejected() -> None:
    async def main() -> None:
        session = DoubleSession(DoubleCell(), five_phases)
        controller = await started(session)
        await controller.until(State.EXECUTE)
        controller.request(Command.COMPLETE)
        await controller.until(State.COMPLETE)
        assert session.trail == ["scan"]
        assert session.ends[0].outcome.verdict == "rejected"
        assert "phase scan" in session.ends[0].outcome.reasons[0]
        await no_task_is_left()

    run_virtual(main())


@pytest.mark.parametrize(
    ("error", "state", "ending"),
    [
        (DeviceTimeout("no answer", device="jack"), State.HELD, "held"),
        (RunHeld("tilt", "tilt 0.2 deg is above the gate"), State.HELD, "held"),
        (SafetyOpen("e-stop", device="safety"), State.ABORTED, "aborted"),
        (ZeroDivisionError("a mistake"), State.ABORTED, "aborted"),
    ],
)
def test_what_an_error_of_the_run_leads_to(error: Exception, state: State, ending: str) -> None:
    async def fails(session: DoubleSession, checkpoint: Checkpoint, progress: Progress) -> Outcome:
        await session.cell.move("jack", 1.0)
        raise error

    async def main() -> None:
        session = DoubleSession(DoubleCell(), fails)
        controller = await started(session)
        assert await controller.until(State.HELD, State.ABORTED, State.COMPLETE) is state
        assert [end.ending for end in session.ends] == [ending]
        snapshot = controller.snapshot()
        assert str(error) in snapshot.why or error.args[0] in snapshot.why or "tilt" in snapshot.why
        assert Command.UNHOLD not in snapshot.allowed  # the run has ended
        assert session.cell.halted_at
        await no_task_is_left()

    run_virtual(main())


def test_a_run_that_must_not_begin_leaves_the_cell_stopped() -> None:
    async def main() -> None:
        session = DoubleSession(DoubleCell(), five_phases, prepare_error=RunHeld("dry_run", "the dry run was refused"))
        controller = await started(session)
        await controller.until(State.STOPPED)
        assert controller.snapshot().why == "the dry run was refused"
        assert session.trail == []
        assert [end.ending for end in session.ends] == ["stopped"]

    run_virtual(main())


def test_a_held_verdict_holds_the_cell() -> None:
    async def held(session: DoubleSession, checkpoint: Checkpoint, progress: Progress) -> Outcome:
        return Outcome("held", ("scan coverage 0.4 is below 0.6",))

    async def main() -> None:
        session = DoubleSession(DoubleCell(), held)
        controller = await started(session)
        await controller.until(State.HELD)
        assert session.ends[0].outcome.reasons == ("scan coverage 0.4 is below 0.6",)
        controller.request(Command.STOP)
        await controller.until(State.STOPPED)
        assert len(session.ends) == 1

    run_virtual(main())


def test_a_hung_device_is_told_and_the_stop_becomes_an_abort() -> None:
    async def main() -> None:
        session = DoubleSession(DoubleCell(hung={"heater"}), five_phases)
        controller = await started(session)
        await controller.until(State.EXECUTE)
        await asyncio.sleep(0.3)
        asked = now()
        controller.request(Command.STOP)
        await controller.until(State.ABORTED)
        assert session.cell.halted_at[0] - asked < 1e-6
        assert dict(controller.snapshot().unsafe) == {"heater": "no answer to halt"}
        assert [end.ending for end in session.ends] == ["aborted"]
        controller.request(Command.CLEAR)
        await controller.until(State.ABORTED)  # still hung: it cannot be cleared
        session.cell.hung.clear()
        controller.request(Command.CLEAR)
        await controller.until(State.STOPPED)
        assert controller.snapshot().alarms == ()
        await no_task_is_left()

    run_virtual(main())


def test_a_swallowed_cancellation_is_noticed_within_a_second_and_latched() -> None:
    async def main() -> None:
        session = DoubleSession(DoubleCell(), stubborn)
        controller = await started(session)
        await controller.until(State.EXECUTE)
        asked = now()
        controller.request(Command.STOP)
        await asyncio.sleep(session.cell.halt_s + 1.0 + 1e-6)
        assert now() - asked < 1.1
        assert "cancellation_swallowed" in {alarm.code for alarm in controller.snapshot().alarms}
        await controller.until(State.ABORTED)
        assert Command.CLEAR not in controller.allowed()  # the run is still there
        await asyncio.sleep(5)
        assert Command.CLEAR in controller.allowed()
        assert session.cell.moving == {}
        controller.request(Command.CLEAR)
        await controller.until(State.STOPPED)
        await no_task_is_left()

    run_virtual(main())


def test_an_abort_overtakes_a_stop() -> None:
    async def main() -> None:
        session = DoubleSession(DoubleCell(), five_phases)
        controller = await started(session)
        await controller.until(State.EXECUTE)
        controller.request(Command.STOP)
        await asyncio.sleep(0.01)
        controller.request(Command.ABORT)
        await controller.until(State.ABORTED)
        assert len(session.ends) == 1
        assert not session.open
        await asyncio.sleep(5)
        assert controller.state is State.ABORTED
        await no_task_is_left()

    run_virtual(main())


def test_reset_rearms_and_refuses_idle_until_ready() -> None:
    async def main() -> None:
        cell = DoubleCell()
        reasons = ["the guard door is open", ""]

        async def ready() -> str:
            return reasons.pop(0)

        controller = controller_on(cell, ready)
        controller.request(Command.RESET)
        await controller.until(State.STOPPED)
        assert controller.snapshot().why == "the guard door is open"
        controller.request(Command.RESET)
        await controller.until(State.IDLE)
        assert cell.rearmed == 2

    run_virtual(main())


def test_clear_connects_first_and_says_what_is_not_there() -> None:
    async def main() -> None:
        cell = DoubleCell()
        answers: list[str | Exception] = ["the jack is not there", RuntimeError("a bug"), ""]

        async def connect() -> str:
            answer = answers.pop(0)
            if isinstance(answer, Exception):
                raise answer
            return answer

        controller = Controller(cell, event_log(), safe_deadline_s=0.5, connect=connect)
        controller.request(Command.ABORT, "nothing is there")
        for why in ("the jack is not there", "a bug"):
            await controller.until(State.ABORTED)
            controller.request(Command.CLEAR)
            await controller.until(State.ABORTED, State.STOPPED)
            assert (controller.state, controller.snapshot().why) == (State.ABORTED, why)
            assert [(alarm.code, alarm.latched) for alarm in controller.snapshot().alarms] == [("not_connected", True)]
        controller.request(Command.CLEAR)
        await controller.until(State.STOPPED, State.ABORTED)
        assert (controller.state, controller.snapshot().alarms) == (State.STOPPED, ())

    run_virtual(main())


def test_a_wrong_command_is_refused_with_the_allowed_ones() -> None:
    async def main() -> None:
        controller = controller_on(DoubleCell())
        with pytest.raises(Refused) as caught:
            controller.request(Command.UNHOLD)
        assert caught.value.allowed == (Command.RESET, Command.ABORT)
        with pytest.raises(Refused):
            controller.start(DoubleSession(DoubleCell(), five_phases))

    run_virtual(main())


def test_a_cell_whose_make_safe_hangs_is_aborted_and_told() -> None:
    class Broken(DoubleCell):
        async def make_safe(self, deadline_s: float) -> None:  # type: ignore[override]
            await asyncio.sleep(1e9)

    async def main() -> None:
        session = DoubleSession(Broken(), five_phases)
        controller = await started(session)
        await controller.until(State.EXECUTE)
        asked = now()
        controller.request(Command.STOP)
        await controller.until(State.ABORTED)
        assert now() - asked < 4.0
        assert "make_safe_late" in {alarm.code for alarm in controller.snapshot().alarms}
        assert not session.open
        await no_task_is_left()

    run_virtual(main())


def test_shutdown_leaves_nothing_behind() -> None:
    async def main() -> None:
        session = DoubleSession(DoubleCell(), five_phases)
        controller = await started(session)
        await controller.until(State.EXECUTE)
        await asyncio.sleep(1.5)
        await controller.shutdown()
        assert controller.state is State.STOPPED
        assert not session.open
        await no_task_is_left()

    run_virtual(main())


@pytest.mark.parametrize("seed", range(300))
def test_random_stops(seed: int) -> None:
    """At a random instant random commands, a device may hang, the run may be stubborn: always safe, always closed."""
    draw = Random(seed)

    async def main() -> None:
        cell = DoubleCell(hung={"heater"} if draw.random() < 0.25 else set(), halt_s=draw.uniform(0.0, 0.4))
        session = DoubleSession(cell, stubborn if draw.random() < 0.1 else five_phases)
        controller = await started(session)
        for _ in range(draw.randint(0, 4)):
            await asyncio.sleep(draw.uniform(0.0, 2.0))
            if allowed := controller.allowed():
                controller.request(draw.choice(allowed))
        await asyncio.sleep(draw.uniform(0.0, 1.0))
        final = draw.choice((Command.STOP, Command.ABORT))
        if final in controller.allowed():
            asked = now()
            before = len(cell.halted_at)
            controller.request(final)
            await asyncio.sleep(DEADLINE_S + 1e-6)
            assert len(cell.halted_at) > before
            assert cell.halted_at[before] - asked < 1e-6
        await controller.shutdown()
        assert controller.state in (State.STOPPED, State.ABORTED)
        assert not session.open
        assert len(session.ends) == 1
        assert set(cell.moving) <= cell.hung
        if cell.hung:
            assert controller.state is State.ABORTED
            assert set(dict(controller.snapshot().unsafe)) == cell.hung
        sent = cell.commands
        await asyncio.sleep(60)
        assert cell.commands == sent
        await no_task_is_left()

    run_virtual(main())


@pytest.mark.parametrize(("command", "state"), [(Command.STOP, State.STOPPED), (None, State.ABORTED)])
def test_nothing_is_complete_without_its_record(command: Command | None, state: State) -> None:
    class Unsealed(DoubleSession):
        async def close(self, end: RunEnd) -> None:
            raise OSError("no space left on device")

    async def main() -> None:
        controller = await started(Unsealed(DoubleCell(), five_phases))
        await controller.until(State.EXECUTE)
        if command is not None:
            controller.request(command)
        assert await controller.until(State.COMPLETE, State.STOPPED, State.ABORTED) is state
        assert [alarm.code for alarm in controller.snapshot().alarms] == ["record_failed"]

    run_virtual(main())
