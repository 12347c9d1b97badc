"""The only owner of the run task: starts it, holds it, makes the cell safe and ends it.

Commands are plain calls that change the state at once and leave the work to a task of its own, so that none waits
behind a step. Whatever ends a run goes the same way: halt all devices, cancel the run, halt again whatever it sent
meanwhile, close its record. That way is no child of what it cancels and is itself never cancelled.
"""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Awaitable, Callable, Coroutine
from dataclasses import dataclass
from typing import Any

from cellctl.alarms import Alarm, AlarmBoard
from cellctl.event_log import EventLog
from cellctl.failures import INTERNAL_ERROR, Failure, failure_of
from cellctl.gate import Gate
from cellctl.halting import answer_of, prove_safe
from cellctl.session import Ending, Outcome, RunEnd, SafeCell, Session
from cellctl.states import ON_DONE, Command, Refused, State, after, allowed_commands

CANCEL_LIMIT_S = 1.0
"""A run that is not gone this long after its cancellation has swallowed it."""
CLOSE_LIMIT_S = 30.0
"""What the closing of a record may take before it counts as broken."""
HUNTS = 10
"""How often a run that swallows its cancellation is cancelled again."""

_AT_REST = frozenset({State.STOPPED, State.IDLE, State.HELD, State.SUSPENDED, State.ABORTED, State.COMPLETE})
_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class Snapshot:
    """All that is to be said about the cell at one instant. `since_s` is loop time; `why` one sentence or empty."""

    state: State
    since_s: float
    allowed: tuple[Command, ...]
    why: str
    alarms: tuple[Alarm, ...]
    unsafe: tuple[tuple[str, str], ...]
    run_id: str | None
    job_order_id: str | None
    phase: str
    fraction: float
    text: str


class Controller:
    """State machine of the cell. `ready` names what forbids Idle, or returns an empty string; `connect` connects what
    is not connected and gives the reason where that failed.

    `wall_s` is how many seconds of the loop's time one second of the wall lasts: what waits for disks and worker
    processes is limited in seconds of the wall.
    """

    def __init__(
        self,
        cell: SafeCell,
        events: EventLog,
        *,
        safe_deadline_s: float,
        ready: Callable[[], Awaitable[str]] | None = None,
        connect: Callable[[], Awaitable[str]] | None = None,
        wall_s: float = 1.0,
    ) -> None:
        self._cell = cell
        self._events = events
        self._deadline_s = safe_deadline_s
        self._ready = ready
        self._connect = connect
        self._wall_s = wall_s
        self._state = State.STOPPED
        self._since_s = asyncio.get_running_loop().time()
        self._why = ""
        self._alarms = AlarmBoard(events)
        self._unsafe: dict[str, str] = {}
        self._session: Session | None = None
        self._run_task: asyncio.Task[None] | None = None
        self._ready_task: asyncio.Task[None] | None = None
        self._closing: asyncio.Task[None] | None = None
        self._gate = self._new_gate()
        self._progress = ("", 0.0, "")
        self._tasks: set[asyncio.Task[Any]] = set()
        self._epoch = 0
        self._changed = asyncio.Event()

    # ------------------------------------------------------------ what may be seen

    @property
    def state(self) -> State:
        """The present state."""
        return self._state

    def allowed(self) -> tuple[Command, ...]:
        """The commands that may be given now. `start` is never among them: a job order starts a run."""
        never = {Command.START}
        if not self._alive():
            never.add(Command.UNHOLD)  # the run has ended: nothing is left to go on with
        elif self._state in (State.ABORTED, State.STOPPED, State.COMPLETE):
            never |= {Command.CLEAR, Command.RESET}  # a run that swallowed its cancellation is still there
        return tuple(command for command in allowed_commands(self._state) if command not in never)

    def snapshot(self) -> Snapshot:
        """Everything at this instant."""
        session = self._session
        return Snapshot(
            self._state,
            self._since_s,
            self.allowed(),
            self._why,
            self._alarms.standing,
            tuple(self._unsafe.items()),
            session.run_id if session else None,
            session.job_order_id if session else None,
            *self._progress,
        )

    async def until(self, *states: State) -> State:
        """Wait until the cell is in one of `states` (or in any at rest, where none is named)."""
        wanted = frozenset(states) or _AT_REST
        while self._state not in wanted:
            await self._changed.wait()
        return self._state

    # ------------------------------------------------------------ what may be asked

    def request(self, command: Command, why: str = "") -> State:
        """Take a command: the state changes now, the work follows. Raises Refused with what is allowed."""
        if command not in self.allowed():
            raise Refused(command, self._state, self.allowed())
        self._epoch += 1
        self._enter(after(self._state, command), why)
        match command:
            case Command.HOLD | Command.SUSPEND:
                self._gate.ask()
                if self._gate.paused:  # suspended: the holding condition is reached already
                    self._reached()
            case Command.UNHOLD | Command.UNSUSPEND:
                self._gate.release()
            case Command.COMPLETE:
                self._gate.ask_end()
                self._spawn(self._complete_early(self._epoch))
            case Command.STOP:
                self._leave("stopped", Outcome("held", (why or "stopped by command",)))
            case Command.ABORT:
                self._leave("aborted", Outcome("held", (why or "aborted by command",)))
            case Command.RESET:
                self._ready_task = self._spawn(self._reset(self._epoch))
            case Command.CLEAR:
                self._ready_task = self._spawn(self._clear(self._epoch))
        return self._state

    def start(self, session: Session) -> None:
        """Begin a run. Raises Refused unless the cell is Idle."""
        if self._state is not State.IDLE:
            raise Refused(Command.START, self._state, self.allowed())
        self._session = session
        self._closing = None
        self._gate = self._new_gate()
        self._progress = ("", 0.0, "")
        self._epoch += 1
        self._enter(State.STARTING)
        self._run_task = self._spawn(self._run(session))

    def report(self, phase: str, fraction: float, text: str) -> None:
        """`cellctl.ports.Progress`: told by the run, seen by everyone; a repetition is not told again."""
        if self._progress != (phase, fraction, text):
            self._progress = (phase, fraction, text)
            self._events.publish("progress", {"phase": phase, "fraction": fraction, "text": text})

    async def shutdown(self) -> None:
        """Stop what runs, wait until it is unwound, leave no task behind."""
        if Command.STOP in self.allowed():
            self.request(Command.STOP, "the service ends")
        while self._tasks:
            await asyncio.wait(self._tasks, timeout=2 * CLOSE_LIMIT_S * self._wall_s)
            if self._state in _AT_REST:
                for task in self._tasks:
                    task.cancel()
                if self._tasks:
                    await asyncio.wait(self._tasks, timeout=CANCEL_LIMIT_S)
                return

    # ------------------------------------------------------------ the run

    async def _run(self, session: Session) -> None:
        try:
            await session.prepare()
            await self._gate()
            if self._state is State.STARTING:
                self._enter(State.EXECUTE)
            outcome = await session.execute(self._gate, self)
            await self._gate()  # a hold that was asked for after the last checkpoint
        except Exception as error:
            failure = failure_of(error)
            foreseen = failure.code != INTERNAL_ERROR
            _log.log(logging.INFO if foreseen else logging.ERROR, "run %s: %s", session.run_id, error, exc_info=error)
            self._fail(failure)
            return
        task = asyncio.current_task()
        if task is not None and task.cancelling():
            self._swallowed()
        elif outcome.verdict == "held":
            self._fail(Failure("hold", "run_held", "; ".join(outcome.reasons) or "the run cannot go on"))
        elif self._state in (State.EXECUTE, State.COMPLETING):
            if self._state is State.EXECUTE:
                self._enter(State.COMPLETING)
            self._leave("complete", outcome)

    def _fail(self, failure: Failure) -> None:
        """The run ended by itself, badly. Nothing to do where the cell is being unwound for another reason."""
        if self._state in (State.STOPPING, State.ABORTING, State.STOPPED, State.ABORTED):
            return
        self._alarms.set(failure.code, failure.reason, latched=failure.reaction == "abort")
        outcome = Outcome("held", (failure.reason,))
        if failure.reaction == "abort":
            self._enter(State.ABORTING, failure.reason)
            self._leave("aborted", outcome)
        elif self._state in (State.STARTING, State.COMPLETING):
            self._enter(State.STOPPING, failure.reason)
            self._leave("stopped", outcome)
        else:
            self._enter(State.HOLDING, failure.reason)
            self._leave("held", outcome)

    async def _complete_early(self, epoch: int) -> None:
        run = self._run_task
        reached = self._spawn(self._gate.end_reached.wait())
        try:
            await asyncio.wait({reached, *([run] if run else [])}, return_when=asyncio.FIRST_COMPLETED)
        finally:
            reached.cancel()
        if self._gate.end_reached.is_set() and epoch == self._epoch:
            reason = f"completed by command in phase {self._progress[0] or 'start'}, before the last"
            self._leave("complete", Outcome("rejected", (reason,)))

    # ------------------------------------------------------------ the way out

    def _leave(self, ending: Ending, outcome: Outcome) -> None:
        self._epoch += 1
        self._spawn(self._unwind(self._epoch, ending, outcome))

    async def _unwind(self, epoch: int, ending: Ending, outcome: Outcome) -> None:
        """Halt first, cancel second, close third. Ends in the state that belongs to the acting one."""
        await self._make_safe()
        if self._victims():
            await self._cancel_work()
            await self._make_safe()
        if epoch == self._epoch:
            ending = "aborted" if self._escalated() else ending
            if ending == "aborted" and outcome.verdict != "held":
                outcome = Outcome("held", (f"the joint was {outcome.verdict}, then: {self._why}", *outcome.reasons))
        await self._close(RunEnd(ending, outcome))
        if epoch == self._epoch:  # otherwise overtaken by a stronger command, which goes the same way
            self._escalated()
            self._enter(ON_DONE[self._state])

    def _escalated(self) -> bool:
        """Whatever is latched turns the way out into an abort."""
        latched = self._alarms.latched
        if latched is not None and self._state is not State.ABORTING:
            self._enter(State.ABORTING, latched.text)
        return self._state is State.ABORTING

    async def _make_safe(self) -> None:
        proof = await prove_safe(self._cell, self._deadline_s, self._spawn)
        self._unsafe = proof.unsafe
        if proof.code:
            self._alarms.set(proof.code, proof.text, latched=True)

    def _victims(self) -> set[asyncio.Task[None]]:
        return {task for task in (self._run_task, self._ready_task) if task is not None and not task.done()}

    async def _cancel_work(self) -> None:
        victims = self._victims()
        for task in victims:
            task.cancel()
        if victims:
            _, left = await asyncio.wait(victims, timeout=CANCEL_LIMIT_S * self._wall_s)
            for task in left:
                self._swallowed()
                self._spawn(self._hunt(task))

    def _swallowed(self) -> None:
        self._alarms.set("cancellation_swallowed", "the run did not end when it was cancelled", latched=True)

    async def _hunt(self, task: asyncio.Task[None]) -> None:
        """Cancel again what swallowed its cancellation, and halt whatever it still sends."""
        for _ in range(HUNTS):
            task.cancel()
            await asyncio.wait({task}, timeout=CANCEL_LIMIT_S * self._wall_s)
            await self._make_safe()
            if task.done():
                break
        self._tell()

    async def _close(self, end: RunEnd) -> None:
        session = self._session
        if session is None:
            return
        if self._closing is None:
            self._closing = self._spawn(session.close(end))
        closing = self._closing
        grave = end.ending == "complete"  # nothing is complete without its record
        await asyncio.wait({closing}, timeout=CLOSE_LIMIT_S * self._wall_s)
        if not closing.done():
            self._alarms.set("record_open", "the record was not closed in time", latched=True)
        elif not closing.cancelled() and (error := closing.exception()) is not None:
            _log.error("the record of run %s was not closed", session.run_id, exc_info=error)
            self._alarms.set("record_failed", f"the record was not closed: {error}", latched=grave)

    # ------------------------------------------------------------ back to work

    async def _reset(self, epoch: int) -> None:
        """Set-points become what is measured, then the cell must say that it is ready."""
        reason = ""
        try:
            await self._cell.rearm()
            reason = await self._ready() if self._ready else ""
        except Exception as error:
            reason = str(error)
        if epoch != self._epoch:
            return
        if reason:
            self._alarms.set("not_ready", reason, latched=False)
            self._enter(State.STOPPING, reason)
            self._leave("stopped", Outcome("held", (reason,)))
            return
        self._alarms.clear()
        self._session = None
        self._progress = ("", 0.0, "")
        self._enter(State.IDLE)

    async def _clear(self, epoch: int) -> None:
        """Latched alarms go only if every device is connected and proven safe now."""
        self._alarms.clear()
        if unreachable := await answer_of(self._connect):
            self._alarms.set("not_connected", unreachable, latched=True)
        else:
            await self._make_safe()
        if epoch != self._epoch:
            return
        latched = self._alarms.latched
        if latched is not None:
            self._enter(State.ABORTING, latched.text)
            self._leave("aborted", Outcome("held", (latched.text,)))
        else:
            self._enter(State.STOPPED)

    # ------------------------------------------------------------ small things

    def _reached(self) -> None:
        if self._state in (State.HOLDING, State.SUSPENDING):
            self._enter(ON_DONE[self._state])

    def _left(self) -> None:
        if self._state in (State.UNHOLDING, State.UNSUSPENDING):
            self._enter(ON_DONE[self._state])

    def _new_gate(self) -> Gate:
        return Gate(on_asked=self._asked, on_reached=self._reached, on_left=self._left)

    def _asked(self, why: str) -> None:
        """The run needs a person: it suspends itself, and unsuspend is the person's word."""
        if self._state is State.EXECUTE:
            self._enter(after(State.EXECUTE, Command.SUSPEND), why)

    def _alive(self) -> bool:
        return self._run_task is not None and not self._run_task.done()

    def _enter(self, state: State, why: str = "") -> None:
        before, self._state = self._state, state
        keeps = state in (State.STOPPED, State.HELD, State.SUSPENDED, State.ABORTED)
        self._why = why or (self._why if keeps else "")
        self._since_s = asyncio.get_running_loop().time()
        self._changed.set()
        self._changed = asyncio.Event()
        self._tell(before=str(before))

    def _tell(self, **more: object) -> None:
        allowed = [str(command) for command in self.allowed()]
        run_id = self._session.run_id if self._session else None
        told = {"state": str(self._state), "why": self._why, "allowed_commands": allowed, "run_id": run_id}
        self._events.publish("state", told | more)

    def _spawn(self, work: Coroutine[Any, Any, Any]) -> asyncio.Task[Any]:
        task = asyncio.get_running_loop().create_task(work)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)
        return task
