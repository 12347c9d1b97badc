"""The cell: what it is doing, and the commands that it takes."""

from __future__ import annotations

import asyncio
from typing import Annotated

from fastapi import APIRouter, Depends

from cellctl.api.auth import INCLUDES, Allow, Principal, Role
from cellctl.api.problems import ProblemError
from cellctl.api.schemas import Alarm, Cell, CommandRequest, CommandTaken, Progress, UnsafeDevice
from cellctl.api.services import Services, services_of
from cellctl.api.strict import StrictRoute
from cellctl.safety_watch import WORKING
from cellctl.states import Command, Refused

router = APIRouter(route_class=StrictRoute, tags=["cell"])
MES_MAY = frozenset({Command.SUSPEND, Command.UNSUSPEND, Command.STOP, Command.ABORT})


@router.get("/cell", dependencies=[Depends(Allow(Role.VIEWER))])
async def cell(services: Annotated[Services, Depends(services_of)]) -> Cell:
    """The cell at this instant."""
    now = services.controller.snapshot()
    left = services.time_left_s(now) if now.state in WORKING else None  # a run that has ended has no time left to tell
    return Cell(
        name=services.cell_name,
        simulated=services.simulated,
        state=str(now.state),
        mode="Production",
        why=now.why,
        run_id=now.run_id,
        job_order_id=now.job_order_id,
        phase=now.phase,
        progress=Progress(fraction=now.fraction, text=now.text, time_left_s=left),
        allowed_commands=[str(command) for command in now.allowed],
        alarms=[Alarm(code=alarm.code, text=alarm.text, latched=alarm.latched) for alarm in now.alarms],
        unsafe_devices=[UnsafeDevice(device=device, reason=reason) for device, reason in now.unsafe],
        in_state_s=asyncio.get_running_loop().time() - now.since_s,
        event_sequence=services.events.last,
        event_id=services.events.last_id,
    )


@router.post("/cell/commands", status_code=202)
async def command(
    asked: CommandRequest,
    who: Annotated[Principal, Depends(Allow(Role.OPERATOR, Role.MES))],
    services: Annotated[Services, Depends(services_of)],
) -> CommandTaken:
    """Take a command. 409 names those that are allowed; stop and abort are never limited in rate."""
    wanted = Command(asked.command)
    if Role.OPERATOR not in INCLUDES[who.role] and wanted not in MES_MAY:
        raise ProblemError(403, "role_missing", f"{who.role} may not {wanted} the cell")
    if wanted is Command.START:
        raise ProblemError(409, "needs_job_order", "a run is started by posting a job order")
    why = f"{wanted} by {who.name}" + (f": {asked.reason}" if asked.reason else "")
    try:
        state = services.controller.request(wanted, why)
    except Refused:
        services.metrics.command(wanted, taken=False)
        raise
    services.metrics.command(wanted, taken=True)
    allowed = [str(each) for each in services.controller.allowed()]
    return CommandTaken(command=str(wanted), state=str(state), allowed_commands=allowed)
