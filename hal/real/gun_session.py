"""What an Open Protocol controller is asked for: start, subscriptions, parameter sets, old results."""

from __future__ import annotations

from hal.bus.open_protocol import Refused, Session
from hal.codec import open_protocol_messages as m
from hal.codec import open_protocol_trace as t
from hal.codec.open_protocol import Message
from hal.codec.open_protocol_result import Result, read_result
from hal.errors import DeviceRefused
from hal.interfaces import Identity

START_REVISIONS = (4, 3, 2, 1)
"""MID 0001: from 4 on the controller tells its serial number."""
RESULT_REVISIONS = (2, 1)
SIMULATED = "simulated"
"""A controller whose name begins so is none."""


async def begin(session: Session, device: str) -> Identity:
    """Start the communication with the highest revision that the controller knows; returns who it is."""
    told = m.read_started(await _stepping_down(session, m.START, START_REVISIONS, device))
    serial = told.serial
    if not serial:
        serial = m.read_tool(await session.ask(Message(m.TOOL_ASK)))[1]
    return Identity(
        vendor=told.supplier or "unknown",
        model=told.controller or "Open Protocol controller",
        serial=serial,
        firmware=told.firmware or "unknown",
        simulated=told.controller.startswith(SIMULATED),
    )


async def subscribe(session: Session, relay: int, device: str) -> None:
    """Everything that a tightening needs to hear of; results come last, so that nothing of them is missed.

    Raises DeviceRefused where the controller offers no curves: each tightening is judged by its curve too.
    """
    await _subscribed(session, Message(m.SELECTED_SUBSCRIBE))
    await _subscribed(session, Message(m.RELAY_SUBSCRIBE, b"%03d" % relay, no_ack=True))
    await _subscribed(session, Message(m.ALARM_SUBSCRIBE))
    try:
        curves = m.subscription(m.TRACE, 1, t.wanted((t.ANGLE, t.TORQUE)), no_ack=True)
        await _subscribed(session, curves, subject=m.TRACE)
    except Refused as error:
        raise DeviceRefused(f"offers no curves (MID 0900, error {error.error:02d})", device=device) from None
    await _stepping_down(session, m.RESULT_SUBSCRIBE, RESULT_REVISIONS, device)


async def _subscribed(session: Session, request: Message, *, subject: int = 0) -> None:
    try:
        await session.ask(request, subject=subject)
    except Refused as error:
        if error.error not in m.SUBSCRIBED_ALREADY:
            raise


async def _stepping_down(session: Session, mid: int, revisions: tuple[int, ...], device: str) -> Message:
    for revision in revisions:
        try:
            return await session.ask(Message(mid, revision=revision))
        except Refused as error:
            if error.error in m.SUBSCRIBED_ALREADY:
                return Message(m.ACCEPTED)
            if error.error != m.REVISION_UNSUPPORTED:
                raise
    raise DeviceRefused(f"knows no revision {min(revisions)} to {max(revisions)} of MID {mid:04d}", device=device)


async def parameter_sets(session: Session) -> tuple[m.ParameterSet, ...]:
    """Every parameter set of the controller."""
    numbers = m.read_set_ids(await session.ask(Message(m.SET_IDS_ASK)))
    return tuple([await parameter_set(session, number) for number in numbers])


async def parameter_set(session: Session, number: int) -> m.ParameterSet:
    """What the controller tells of parameter set `number`."""
    return m.read_set(await session.ask(m.numbered(m.SET_ASK, number, 3)))


async def old_result(session: Session, number: int) -> Result | None:
    """The stored tightening `number` (0: the latest), or None where the controller has it no more."""
    try:
        return read_result(await session.ask(m.numbered(m.OLD_RESULT_ASK, number, 10)))
    except Refused as error:
        if error.error != m.NOT_FOUND:
            raise
        return None


async def old_curve(session: Session, number: int, kind: int) -> Message | None:
    """MID 0900 of a stored tightening, or None where the controller cannot give it."""
    try:
        return await session.ask(m.request(m.TRACE, 1, t.of_result(number, kind)), subject=m.TRACE)
    except Refused:
        return None
