"""A safety input that opens aborts a cell that works, and leaves a cell at rest alone."""

from __future__ import annotations

import asyncio

from cellctl.safety_watch import watch_safety
from cellctl.states import Command, State
from hal.clock import run_virtual
from tests.doubles import DoubleCell, DoubleSession, five_phases
from tests.test_controller import controller_on


def test_an_open_input_aborts_a_working_cell_only() -> None:
    async def main() -> None:
        opened = asyncio.Event()

        async def until_unsafe() -> str:
            await opened.wait()
            return "e-stop is pressed"

        session = DoubleSession(DoubleCell(), five_phases)
        controller = controller_on(session.cell)
        watch = asyncio.create_task(watch_safety(controller, until_unsafe))
        controller.request(Command.RESET)
        await controller.until(State.IDLE)
        opened.set()
        await asyncio.sleep(1)
        assert controller.state is State.IDLE
        opened.clear()
        controller.start(session)
        await controller.until(State.EXECUTE)
        opened.set()
        await controller.until(State.ABORTED)
        assert controller.snapshot().why == "e-stop is pressed"
        assert [end.ending for end in session.ends] == ["aborted"]
        watch.cancel()

    run_virtual(main())
