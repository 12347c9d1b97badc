"""Modbus lines: one connection to a server or one serial port, shared by all devices behind it.

One monitor task per line owns connecting, polling and recovering. An exchange has a deadline and is never repeated.
After a time-out a serial line stays quiet until the slowest reply must have come, and a TCP connection is made anew:
half a frame or a late one is never taken for the next answer.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import math
from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from typing import Literal, NoReturn

from pymodbus import FramerType, ModbusException
from pymodbus.client import AsyncModbusSerialClient, AsyncModbusTcpClient
from pymodbus.pdu import ModbusPDU

from hal.codec.modbus import READ_COILS, READ_HOLDING, READ_INPUT, WRITE_COIL, WRITE_MANY, ExceptionCode, Framing
from hal.errors import (
    CellError,
    ConfigError,
    DeviceError,
    DeviceFault,
    DeviceRefused,
    DeviceTimeout,
    NotConnected,
    UnknownOutcome,
)

logging.getLogger("pymodbus.logging").setLevel(logging.CRITICAL)  # the errors raised here say it, with the device

_REFUSED = (ExceptionCode.ILLEGAL_FUNCTION, ExceptionCode.ILLEGAL_ADDRESS, ExceptionCode.ILLEGAL_VALUE)
_GATEWAY = (ExceptionCode.GATEWAY_PATH, ExceptionCode.GATEWAY_TARGET)
MOST_BYTES = 4096
"""Kept of what comes in one go. By itself the client forgets all of it beyond one frame's size, a good answer too where
it comes twice."""
RETRY_S = 0.5
"""Pause between two attempts to connect while nobody asks."""

Client = AsyncModbusTcpClient | AsyncModbusSerialClient
Poll = Callable[[], Awaitable[object]]


@dataclass(frozen=True, slots=True)
class Link:
    """Where a line goes: a host, or the serial port `port_path`. `worst_reply_s` is how late a device may answer."""

    host: str = "127.0.0.1"
    port: int = 502
    framing: Framing = "tcp"
    port_path: str = ""
    baud: int = 19200
    parity: Literal["N", "E", "O"] = "E"
    deadline_s: float = 1.5
    worst_reply_s: float = 2.0

    def __post_init__(self) -> None:
        if self.port_path and self.framing != "rtu":
            raise ConfigError("a serial port speaks rtu only", place="framing")

    def __str__(self) -> str:
        return self.port_path or f"{self.host}:{self.port}"

    @property
    def serial(self) -> bool:
        """Whether devices answer one after the other on a wire that knows no transaction numbers."""
        return self.framing == "rtu"


class Lines:
    """The lines of a cell: devices with the same link share one."""

    def __init__(self) -> None:
        self._lines: dict[Link, Line] = {}

    def to(self, link: Link) -> Line:
        """The line of `link`."""
        return self._lines.setdefault(link, Line(link))


class Line:
    """One connection. It stands while at least one device holds it open."""

    def __init__(self, link: Link) -> None:
        self.link = link
        self._holders: set[object] = set()
        self._client: Client | None = None
        self._task: asyncio.Task[None] | None = None
        self._polls: dict[object, tuple[int, float, Poll]] = {}
        self._heard_s: dict[int, float] = {}
        self._errands: list[Poll] = []
        self._why = ""
        self.connection = 0
        """Counts connections: what was read on one says nothing on the next."""
        self._sent_s = self._quiet_until_s = -math.inf

    async def open(self, holder: object) -> None:
        """Hold the line open for `holder`; the first one starts the monitor."""
        self._holders.add(holder)
        if self._task is None:
            self._lock, self._wake = asyncio.Lock(), asyncio.Event()
            loop = asyncio.get_running_loop()
            self._lost: asyncio.Future[None] = loop.create_future()
            self._attempt: asyncio.Future[bool] = loop.create_future()
            self._task = asyncio.create_task(self._monitor(), name=f"modbus {self.link}")

    async def close(self, holder: object) -> None:
        """Let go; the last one takes the line down. Never raises."""
        self._holders.discard(holder)
        self._polls.pop(holder, None)
        task = self._task
        if self._holders or task is None:
            return
        self._task = None
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)
        self._drop(self._client)
        if not self._attempt.done():
            self._attempt.set_result(False)

    def poll(self, holder: object, unit: int, every_s: float, call: Poll) -> None:
        """Have the monitor await `call` where nothing was asked of `unit` for `every_s`, until `holder` lets go."""
        self._polls[holder] = (unit, every_s, call)
        self._wake.set()

    def errand(self, call: Poll) -> None:
        """Have the monitor await `call` once, soon: for what must be sent by a task that is being cancelled."""
        self._errands.append(call)
        self._wake.set()

    async def read(self, unit: int, address: int, count: int, *, device: str, holding: bool = False) -> tuple[int, ...]:
        """`count` input or holding registers. Raises NotConnected, DeviceTimeout, DeviceRefused, DeviceFault."""
        what = f"read of {count} registers at {address} of unit {unit}"

        def request(client: Client) -> Awaitable[ModbusPDU]:
            read = client.read_holding_registers if holding else client.read_input_registers
            return read(address, count=count, device_id=unit)

        reply = await self._exchange(request, what, READ_HOLDING if holding else READ_INPUT, device)
        self._heard_s[unit] = asyncio.get_running_loop().time()
        if len(reply.registers) != count:
            self._spoil(self._client)
            raise DeviceFault(f"{len(reply.registers)} registers came to a {what}", device=device)
        return tuple(reply.registers)

    async def write(self, unit: int, address: int, words: tuple[int, ...], *, device: str) -> None:
        """Write holding registers, once. Raises as `read`, and UnknownOutcome where the link broke on the way."""
        what = f"write of {len(words)} registers at {address} of unit {unit}"

        def request(client: Client) -> Awaitable[ModbusPDU]:
            return client.write_registers(address, list(words), device_id=unit)

        reply = await self._exchange(request, what, WRITE_MANY, device)
        self._heard_s[unit] = asyncio.get_running_loop().time()
        if (reply.address, reply.count) != (address, len(words)):
            self._spoil(self._client)
            raise DeviceFault(f"{reply.count} registers at {reply.address} acknowledged to a {what}", device=device)

    async def coils(self, unit: int, address: int, count: int, *, device: str) -> tuple[bool, ...]:
        """`count` coils. Raises as `read`."""
        what = f"read of {count} coils at {address} of unit {unit}"

        def request(client: Client) -> Awaitable[ModbusPDU]:
            return client.read_coils(address, count=count, device_id=unit)

        reply = await self._exchange(request, what, READ_COILS, device)
        self._heard_s[unit] = asyncio.get_running_loop().time()
        if len(reply.bits) != -(-count // 8) * 8:
            self._spoil(self._client)
            raise DeviceFault(f"{len(reply.bits)} coils came to a {what}", device=device)
        return tuple(reply.bits[:count])

    async def set_coil(
        self, unit: int, address: int, on: bool, *, device: str, check: Callable[[], None] | None = None
    ) -> None:
        """Write one coil, once. `check` is called right before it is sent and may raise. Raises as `write`."""
        what = f"write of coil {address} of unit {unit}"

        def request(client: Client) -> Awaitable[ModbusPDU]:
            if check is not None:
                check()
            return client.write_coil(address, on, device_id=unit)

        reply = await self._exchange(request, what, WRITE_COIL, device)
        self._heard_s[unit] = asyncio.get_running_loop().time()
        if (reply.address, tuple(reply.bits[:1])) != (address, (on,)):
            self._spoil(self._client)
            raise DeviceFault(f"coil {reply.address} acknowledged to a {what}", device=device)

    async def _exchange(
        self, request: Callable[[Client], Awaitable[ModbusPDU]], what: str, function: int, device: str
    ) -> ModbusPDU:
        if self._task is None:
            raise NotConnected(f"not connected ({what})", device=device)
        await self._stand(what, device)
        async with self._lock:
            loop = asyncio.get_running_loop()
            await asyncio.sleep(max(0.0, self._quiet_until_s - loop.time()))
            client, lost = self._client, self._lost
            if client is None:
                raise NotConnected(f"the link to {self.link} is down ({what})", device=device)
            self._sent_s = loop.time()
            call = asyncio.ensure_future(request(client))
            try:
                async with asyncio.timeout(self.link.deadline_s):
                    await asyncio.wait((call, lost), return_when=asyncio.FIRST_COMPLETED)
            except TimeoutError:
                raise DeviceTimeout(f"no answer to {what} within {self.link.deadline_s:g} s", device=device) from None
            finally:
                if not call.done():
                    call.cancel()
                    self._spoil(client)
                    await asyncio.gather(call, return_exceptions=True)
            if call.cancelled():
                self._raise_lost(what, function, device)
            return self._judged(call, what, function, device)

    def _judged(self, call: asyncio.Future[ModbusPDU], what: str, function: int, device: str) -> ModbusPDU:
        """The reply, if it answers this request and is no exception."""
        if isinstance(call.exception(), ModbusException | OSError):
            self._raise_lost(what, function, device)
        reply = call.result()
        asked = reply.function_code & 0x7F
        if asked != function:
            self._spoil(self._client)
            raise DeviceFault(f"an answer to function {asked} came to a {what}", device=device)
        if reply.isError():
            raise _exception(getattr(reply, "exception_code", 0), what, device)
        return reply

    def _raise_lost(self, what: str, function: int, device: str) -> NoReturn:
        if function in (WRITE_COIL, WRITE_MANY):
            raise UnknownOutcome(f"the link to {self.link} broke in a {what}: it may have acted", device=device)
        raise NotConnected(f"the link to {self.link} broke in a {what}", device=device)

    async def _stand(self, what: str, device: str) -> None:
        """Wait until the monitor has the line up, or its next attempt has failed."""
        if self._client is None and asyncio.current_task() is not self._task:
            self._wake.set()
            if not await asyncio.shield(self._attempt):
                raise NotConnected(f"no connection to {self.link}{self._why} ({what})", device=device)

    def _spoil(self, client: Client | None) -> None:
        """A reply to what was asked may still come, whole or in part."""
        if self.link.serial:
            self._quiet_until_s = self._sent_s + self.link.worst_reply_s
        else:
            self._drop(client)

    def _drop(self, client: Client | None) -> None:
        """Forget this connection, if it is the present one; the monitor makes another."""
        if client is None or client is not self._client:
            return
        self._client = None
        client.close()
        if not self._lost.done():
            self._lost.set_result(None)
        self._wake.set()

    async def _monitor(self) -> None:
        while True:
            self._wake.clear()
            if self._client is None:
                await self._connect()
            if self._client is not None:
                await self._run_due()
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(self._idle_s()):
                    await self._wake.wait()

    async def _connect(self) -> None:
        link, made, self._why = self.link, False, ""
        client = _client(link, lambda up: None if up else self._drop(client))
        try:
            async with asyncio.timeout(link.deadline_s):
                made = await client.connect()
        except Exception as error:  # drivers of serial ports raise what they like, termios.error for one
            self._why = f": {error}"
        if self._task is not asyncio.current_task():
            client.close()
            raise asyncio.CancelledError  # asyncio.wait_for, inside the client, may swallow it
        if made:
            self.connection += 1
            self._client, self._lost = client, asyncio.get_running_loop().create_future()
        else:
            client.close()
        attempt, self._attempt = self._attempt, asyncio.get_running_loop().create_future()
        attempt.set_result(made)

    async def _run_due(self) -> None:
        now = asyncio.get_running_loop().time()
        calls = self._errands
        self._errands = []
        for unit, every_s, call in self._polls.values():
            if now >= self._heard_s.get(unit, -math.inf) + every_s:
                self._heard_s[unit] = now
                calls.append(call)
        for call in calls:
            with contextlib.suppress(CellError):  # whoever asks next is told
                await call()

    def _idle_s(self) -> float | None:
        if self._client is None:
            return RETRY_S
        now = asyncio.get_running_loop().time()
        waits = (self._heard_s.get(unit, now) + every_s - now for unit, every_s, _ in self._polls.values())
        return min((max(0.0, wait) for wait in waits), default=None)


def _client(link: Link, told: Callable[[bool], None]) -> Client:
    """A client that neither repeats nor reconnects by itself; the deadline is the line's."""
    limit_s = 10.0 * link.deadline_s
    client: Client
    if link.port_path:
        client = AsyncModbusSerialClient(
            link.port_path, baudrate=link.baud, parity=link.parity, timeout=limit_s, retries=0, reconnect_delay=0,
            trace_connect=told,
        )  # fmt: skip
    else:
        framer = FramerType.RTU if link.framing == "rtu" else FramerType.SOCKET
        client = AsyncModbusTcpClient(
            link.host, port=link.port, framer=framer, timeout=limit_s, retries=0, reconnect_delay=0, trace_connect=told
        )
    client.ctx.max_buffer_size = MOST_BYTES
    return client


def _exception(code: int, what: str, device: str) -> DeviceError:
    """The error that an exception code stands for."""
    name = ExceptionCode(code).name.lower() if code in list(ExceptionCode) else "unknown"
    reason = f"exception {code} ({name}) to a {what}"
    if code in _GATEWAY:
        return NotConnected(reason, device=device)
    if code in _REFUSED or code == ExceptionCode.BUSY:
        return DeviceRefused(reason, device=device)
    if code == ExceptionCode.ACKNOWLEDGE:
        return UnknownOutcome(reason, device=device)
    return DeviceFault(reason, device=device)
