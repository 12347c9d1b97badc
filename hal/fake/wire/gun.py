"""Simulator of an Open Protocol tightening controller: TCP server outside, the fake gun on the plant inside.

The controller's memory (results, those that nobody acknowledged, the running program) outlives connections. A second
client is refused while the first is there.
"""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Sequence
from dataclasses import replace
from typing import Self

from hal.codec import open_protocol_messages as m
from hal.codec import open_protocol_trace as t
from hal.codec.open_protocol import Message
from hal.codec.open_protocol_result import old_result, result
from hal.entries import OpenProtocolEntry
from hal.errors import CellError, DeviceFault, SafetyOpen, UnknownOutcome
from hal.fake.devices.guns import FakeGun
from hal.fake.faults import FaultBook
from hal.fake.plant import Plant
from hal.fake.wire import gun_memory as memory
from hal.fake.wire.behind import BehindWire
from hal.fake.wire.gun_memory import Program, Record, TurnProgram
from hal.fake.wire.open_protocol import Client, Server, WireFaults
from hal.interfaces import TighteningProgram

START_INPUTS = (7, 8)
RUNNING_RELAY = 26
ESTOP_ALARM, DISABLED_ALARM = "E504", "E505"
"""The hard-wired circuit took the power; the external enable is off."""
NOT_PRESENT, NOT_RUNNING, IN_USE, UNSUPPORTED, FAILED, UNKNOWN = 2, 4, 59, 73, 79, 99


class GunController:
    """One controller. `start` and `close` its network side; `close` also ends what runs."""

    def __init__(
        self,
        name: str,
        plant: Plant,
        faults: FaultBook,
        programs: Sequence[Program],
        *,
        host: str = "127.0.0.1",
        port: int = 0,
        order: t.Order = "big",
    ) -> None:
        """`programs` are its parameter sets, numbered from 1. The plant has its nuts (`install_joints`)."""
        self.name = name
        self.host = host
        self.port = port
        self.wire = WireFaults()
        self.starts: list[str] = []
        """Identifiers of the programs that were started, in order."""
        self.records: list[Record] = []
        self._faults = faults
        self._plant = plant
        self._gun = FakeGun(name, plant, BehindWire(faults))
        self._programs = dict(enumerate(programs, start=1))
        self._sets = {number: memory.told(number, program) for number, program in self._programs.items()}
        self._order = order
        self._untold: list[Record] = []
        self._selected = 0
        self._enabled = False
        self._identifier = ""
        self._alarm: m.Alarm | None = None
        self._program: asyncio.Task[None] | None = None
        self._runs = False
        self._handlers = self._table()
        self._server = Server(name, faults, self.wire, self._handle)

    @classmethod
    def of(
        cls, name: str, entry: OpenProtocolEntry, plant: Plant, faults: FaultBook, programs: Sequence[Program]
    ) -> Self:
        """The controller that `entry` of the cell file names."""
        return cls(name, plant, faults, programs, host=entry.host, port=entry.port, order=entry.trace_order)

    async def start(self) -> int:
        """Listen; returns the port."""
        await self._gun.connect()
        self.port = await self._server.start(self.host, self.port)
        return self.port

    async def close(self) -> None:
        """End everything."""
        await self._server.close()
        await self._end_program()

    def drop(self) -> None:
        """Drop every connection; whatever runs goes on."""
        self._server.drop()

    def program(self, number: int, program: Program) -> None:
        """What a technician does: another content for parameter set `number`."""
        self._programs[number] = program
        self._sets[number] = memory.told(number, program)

    @property
    def turning(self) -> bool:
        """Whether a program runs."""
        return self._runs

    async def power_cycle(self) -> None:
        """Off and on: the program ends where it is and leaves no result; stored results stay."""
        self._server.drop()
        await self._gun.halt()
        await self._end_program()
        self._selected, self._enabled, self._identifier, self._alarm = 0, False, "", None

    @property
    def untold(self) -> tuple[str, ...]:
        """Identifiers of the results that nobody has acknowledged, in order."""
        return tuple(record.result.identifier for record in self._untold)

    async def _end_program(self) -> None:
        if self._program is not None:
            self._program.cancel()
            await asyncio.gather(self._program, return_exceptions=True)
        self._runs = False  # a program that was ended before its first step has not said so itself

    async def _handle(self, client: Client, message: Message) -> list[Message]:
        handler = self._handlers.get(message.mid)
        if handler is None:
            return [m.refused(message.mid, UNKNOWN)]
        known = {m.START: self.wire.start_revision, m.RESULT_SUBSCRIBE: self.wire.result_revision}
        if message.revision > known.get(message.mid, 1):
            return [m.refused(message.mid, m.REVISION_UNSUPPORTED)]
        return await handler(client, message)

    # ------------------------------------------------------------ requests

    def _table(self) -> dict[int, Callable[[Client, Message], Awaitable[list[Message]]]]:
        return {
            m.START: self._begin,
            m.STOP: self._stop,
            m.KEEP_ALIVE: self._mirror,
            m.SET_IDS_ASK: self._tell_ids,
            m.SET_ASK: self._tell_set,
            m.SELECTED_SUBSCRIBE: self._subscribe,
            m.SELECTED_ACK: self._nothing,
            m.SELECT: self._select,
            m.TOOL_ASK: self._tell_tool,
            m.DISABLE: self._disable,
            m.ENABLE: self._enable,
            m.IDENTIFIER: self._take_identifier,
            m.RESULT_SUBSCRIBE: self._subscribe_results,
            m.RESULT_ACK: self._acknowledged,
            m.OLD_RESULT_ASK: self._tell_old,
            m.ALARM_SUBSCRIBE: self._subscribe,
            m.ALARM_ACK: self._nothing,
            m.ALARM_GONE_ACK: self._nothing,
            m.ALARM_STATUS_ACK: self._nothing,
            m.ALARM_CLEAR: self._clear_alarm,
            m.RELAY_SUBSCRIBE: self._subscribe,
            m.RELAY_ACK: self._nothing,
            m.SUBSCRIBE: self._subscribe_curves,
            m.REQUEST: self._tell_curve,
            m.INPUT_SET: self._set_input,
            m.INPUT_RESET: self._accept_only,
        }

    async def _nothing(self, client: Client, message: Message) -> list[Message]:
        return []

    async def _accept_only(self, client: Client, message: Message) -> list[Message]:
        return [m.numbered(m.ACCEPTED, message.mid, 4)]

    async def _mirror(self, client: Client, message: Message) -> list[Message]:
        return [message]

    async def _begin(self, client: Client, message: Message) -> list[Message]:
        if any(other.started for other in self._server.clients if other is not client):
            return [m.refused(m.START, m.CLIENT_CONNECTED)]
        client.started = True
        who = m.Started(1, 1, f"simulated {self.name}", "CEL", "2.8", "1.0", "1.0", "none", self._serial)
        return [m.started(who, message.revision)]

    @property
    def _serial(self) -> str:
        return f"{self.name}-1"

    async def _stop(self, client: Client, message: Message) -> list[Message]:
        client.started = False
        client.subscribed.clear()
        return [m.numbered(m.ACCEPTED, m.STOP, 4)]

    async def _tell_ids(self, client: Client, message: Message) -> list[Message]:
        return [m.set_ids(tuple(self._sets))]

    async def _tell_set(self, client: Client, message: Message) -> list[Message]:
        known = self._sets.get(m.read_number(message, 3))
        return [m.refused(m.SET_ASK, NOT_PRESENT) if known is None else m.set_data(known)]

    async def _tell_tool(self, client: Client, message: Message) -> list[Message]:
        return [m.tool_data(f"tool-{self.name}", self._serial, len(self.records), memory.stamp(0.0))]

    async def _subscribe(self, client: Client, message: Message) -> list[Message]:
        """Subscriptions whose present state is told at once."""
        client.subscribed.add(message.mid)
        now = memory.stamp(asyncio.get_running_loop().time())
        none = m.Alarm("", True, True, now, active=False)
        present = {
            m.SELECTED_SUBSCRIBE: m.selected(self._selected, memory.stamp(0.0)),
            m.ALARM_SUBSCRIBE: m.alarm_status(self._alarm or none),
            m.RELAY_SUBSCRIBE: m.relay(RUNNING_RELAY, self._runs),
        }
        return [m.numbered(m.ACCEPTED, message.mid, 4), present[message.mid]]

    async def _subscribe_results(self, client: Client, message: Message) -> list[Message]:
        client.subscribed.add(message.mid)
        client.result_revision = message.revision
        again = [result(self._untold[0].result, client.result_revision)] if self._untold else []
        return [m.numbered(m.ACCEPTED, message.mid, 4), *again]

    async def _acknowledged(self, client: Client, message: Message) -> list[Message]:
        del self._untold[:1]
        return [result(self._untold[0].result, client.result_revision)] if self._untold else []

    async def _subscribe_curves(self, client: Client, message: Message) -> list[Message]:
        subject, _, extra = m.read_subject(message)
        if subject != m.TRACE or not self.wire.curves:
            return [m.refused(subject, UNSUPPORTED)]
        client.curves = t.read_wanted(extra)
        return [m.numbered(m.ACCEPTED, subject, 4)]

    async def _tell_curve(self, client: Client, message: Message) -> list[Message]:
        subject, _, extra = m.read_subject(message)
        number, kind = t.read_of_result(extra)
        found = self._record(number) if subject == m.TRACE and self.wire.curves else None
        curve = memory.curve(found, kind, self._order) if found is not None else None
        return [m.refused(subject, FAILED) if curve is None else curve]

    async def _tell_old(self, client: Client, message: Message) -> list[Message]:
        found = self._record(m.read_number(message, 10))
        return [m.refused(message.mid, m.NOT_FOUND) if found is None else old_result(found.result)]

    def _record(self, number: int) -> Record | None:
        """The stored tightening; 0 is the latest."""
        return self.records[number - 1] if self.records and number <= len(self.records) else None

    async def _select(self, client: Client, message: Message) -> list[Message]:
        number = m.read_number(message, 3)
        if number not in self._sets:
            return [m.refused(m.SELECT, NOT_PRESENT)]
        self._selected = number
        told = [m.selected(number, memory.stamp(0.0))] if m.SELECTED_SUBSCRIBE in client.subscribed else []
        return [m.numbered(m.ACCEPTED, m.SELECT, 4), *told]

    async def _take_identifier(self, client: Client, message: Message) -> list[Message]:
        self._identifier = message.text.rstrip()
        return [m.numbered(m.ACCEPTED, m.IDENTIFIER, 4)]

    async def _disable(self, client: Client, message: Message) -> list[Message]:
        self._enabled = False
        await self._gun.halt()
        return [m.numbered(m.ACCEPTED, m.DISABLE, 4)]

    async def _enable(self, client: Client, message: Message) -> list[Message]:
        self._enabled = True
        return [m.numbered(m.ACCEPTED, m.ENABLE, 4)]

    async def _clear_alarm(self, client: Client, message: Message) -> list[Message]:
        self._look_at_power()
        return [m.numbered(m.ACCEPTED, m.ALARM_CLEAR, 4)]

    # ------------------------------------------------------------ programs

    async def _set_input(self, client: Client, message: Message) -> list[Message]:
        if m.read_number(message, 3) not in START_INPUTS:
            return [m.numbered(m.ACCEPTED, m.INPUT_SET, 4)]
        if not self._look_at_power() or not self._enabled:
            return [m.refused(m.INPUT_SET, FAILED)]
        if self._runs:
            return [m.refused(m.INPUT_SET, IN_USE)]
        if not self._selected:
            return [m.refused(m.INPUT_SET, NOT_RUNNING)]
        self.starts.append(self._identifier)
        self._turns(True)
        self._program = asyncio.create_task(self._run(self._sets[self._selected], self._identifier), name=self.name)
        return [m.numbered(m.ACCEPTED, m.INPUT_SET, 4)]

    def _look_at_power(self) -> bool:
        """Whether the tool may turn; an alarm comes when it may not, and goes when it may again."""
        now = asyncio.get_running_loop().time()
        cut = bool(self._faults.power_cut(now))
        stopped = cut or not self._plant.tools_enabled
        if stopped and self._alarm is None:
            code = ESTOP_ALARM if cut else DISABLED_ALARM
            self._alarm = m.Alarm(code, controller_ready=True, tool_ready=False, stamp=memory.stamp(now))
            self._server.push(m.ALARM_SUBSCRIBE, m.alarm(self._alarm))
        elif not stopped and self._alarm is not None:
            self._server.push(m.ALARM_SUBSCRIBE, Message(m.ALARM_GONE, self._alarm.code.encode("ascii")))
            self._alarm = None
        return not stopped

    def _turns(self, on: bool) -> None:
        self._runs = on
        self._server.push(m.RELAY_SUBSCRIBE, m.relay(RUNNING_RELAY, on))

    async def _run(self, chosen: m.ParameterSet, identifier: str) -> None:
        """One program from start to end, whoever is connected."""
        program = self._programs[chosen.number]
        told: Record | None = None
        try:
            if isinstance(program, TurnProgram):
                told = await self._turn(chosen, program, identifier)
            else:
                told = await self._tighten(chosen, program, identifier)
        except (SafetyOpen, DeviceFault):
            self._look_at_power()
        except CellError:
            pass  # halted, or refused by the metal: no result
        finally:
            self._turns(False)
        if told is not None:
            await self._tell(told)

    async def _turn(self, chosen: m.ParameterSet, program: TurnProgram, identifier: str) -> Record:
        done = await self._gun.turn(
            program.angle_deg, speed_rpm=program.speed_rpm, torque_limit_nm=program.torque_limit_nm
        )
        self.records.append(memory.of_turn(len(self.records) + 1, identifier, chosen, done))
        return self.records[-1]

    async def _tighten(self, chosen: m.ParameterSet, program: TighteningProgram, identifier: str) -> Record | None:
        """The record that is told: None where it is lost, an older one where that is repeated."""
        inner = f"{identifier}#{len(self.records) + 1}"  # a controller runs an identifier as often as it is told to
        told = True
        try:
            done = await self._gun.tighten(inner, program)
        except UnknownOutcome:
            told = False
        stored = await self._gun.result(inner)
        if stored is None:
            return None
        if self.wire.strange_identifier:
            strange = memory.of_tightening(len(self.records) + 1, self.wire.strange_identifier, chosen, stored)
            self.records.append(strange)
            await self._tell(strange)
        older = self.records[-1] if self.records else None
        self.records.append(memory.of_tightening(len(self.records) + 1, identifier, chosen, stored))
        if not told:
            return None
        return older if done.key != inner and older is not None else self.records[-1]

    async def _tell(self, record: Record) -> None:
        """Tell the result, the next one when it is acknowledged, and its curves."""
        if self.wire.lose_results:
            self.wire.lose_results -= 1
            return
        if self.wire.late_result_s:
            await asyncio.sleep(self.wire.late_result_s)
        self._untold.append(record)
        for client in self._server.clients:
            if m.RESULT_SUBSCRIBE in client.subscribed and len(self._untold) == 1:
                for _ in range(2 if self.wire.repeat_results else 1):
                    self._server.send(client, result(record.result, client.result_revision))
            for kind in client.curves:
                if (curve := memory.curve(record, kind, self._order)) is not None:
                    self._server.send(client, replace(curve, no_ack=True))
