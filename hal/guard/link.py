"""The controller's end of the guard's socket: the CAN bus behind the gate, calls with their answers, what was told.

One monitor task owns connect and recover while anybody uses the link. A guard that says nothing for a while is lost,
whether it died or stands still.
"""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hal import errors
from hal.bus.ears import Ears, Listener
from hal.codec import guard as wire
from hal.codec.guard import GuardMessageError, Kind
from hal.codec.lawicel import CanFrame
from hal.errors import CellError, DeviceError, DeviceTimeout, NotConnected, SafetyOpen
from hal.guard.child import GuardChild
from hal.guard.gate import may_pass

OPEN_S = 4.5
"""Guard and adapter must be there by then; within the cell's own deadline for connecting."""
RETRY_S = 0.1
SILENCE_S = 1.0
"""A guard that tells nothing for so long is lost."""
TICK_S = 0.05
"""Between two looks at what is overdue."""
ANSWER_S = 3.0
"""A call must have its answer by then."""
_ERRORS = {
    one.code: one
    for one in vars(errors).values()
    if isinstance(one, type) and issubclass(one, DeviceError | SafetyOpen)
}


@dataclass(frozen=True, slots=True)
class Told:
    """What the guard told last."""

    epoch: int
    tripped: bool
    reason: str
    force_n: float
    armed: bool
    peak_n: float
    last_n: float
    samples: int
    time_s: float
    bus: str
    sensor: tuple[str, str] | None
    tools: str
    """Why the guns may not turn; empty while they may."""

    @property
    def sensor_error(self) -> CellError | None:
        """What is wrong with the force sensor."""
        return error_of(*self.sensor) if self.sensor else None


def error_of(code: str, reason: str, device: str = "jack_force") -> CellError:
    """The error of that code."""
    return _ERRORS.get(code, DeviceError)(reason, device=device)


class GuardLink:
    """`hal.bus.ears.Link` to the guard at `socket`, lost once it says nothing for `silence_s`.

    `on_told` hears what it tells, `on_lost` that it is lost.
    """

    def __init__(self, socket: Path, child: GuardChild | None = None, *, silence_s: float = SILENCE_S) -> None:
        self._socket = socket
        self._child = child
        self._silence_s = silence_s
        self._ears = Ears()
        self._users = 0
        self._monitor: asyncio.Task[None] | None = None
        self._transport: asyncio.Transport | None = None
        self._lost: asyncio.Event | None = None
        self._news = asyncio.Event()
        self._trouble = "not opened"
        self._tag = 0
        self._asked: dict[int, asyncio.Future[dict[str, Any]]] = {}
        self._heard_s = 0.0
        self.told: Told | None = None
        self.epoch = 0
        """The trip that was cleared last: what is sent moves something only while there was none since."""
        self.on_told: Callable[[Told], None] = lambda told: None
        self.on_lost: Callable[[str], None] = lambda reason: None

    # ------------------------------------------------------------ life

    async def reached(self, *, bus: bool = False, within_s: float = OPEN_S) -> None:
        """One more user; returns once the guard (and with `bus` its adapter) is there. Raises NotConnected."""
        self._users += 1
        if self._monitor is None:
            self._monitor = asyncio.get_running_loop().create_task(self._run(), name="guard link")
        try:
            async with asyncio.timeout(within_s):
                while self.told is None or (bus and self.told.bus):
                    self._news.clear()
                    await self._news.wait()
        except BaseException as error:
            reason = f"guard: {self.told.bus if self.told else self._trouble}"
            await self.release()
            if isinstance(error, TimeoutError):
                raise NotConnected(reason, device="guard") from None
            raise

    async def open(self) -> None:
        """See `hal.bus.ears.Link`."""
        await self.reached(bus=True)

    async def release(self) -> None:
        """One user less; the last one closes the link. Never raises."""
        self._users -= 1
        monitor = self._monitor
        if self._users == 0 and monitor is not None:
            self._monitor = None
            monitor.cancel()
            await asyncio.wait({monitor})

    async def _run(self) -> None:
        try:
            while True:
                if self._child is not None:
                    self._child.ensure()
                try:
                    await self._connected()
                except OSError as error:
                    self._trouble = f"{self._socket}: {error.strerror or error}"
                await asyncio.sleep(RETRY_S)
        finally:
            if self._child is not None:
                await self._child.close()

    async def _connected(self) -> None:
        """Stay until the connection has ended. Raises OSError where there is none."""
        loop, lost = asyncio.get_running_loop(), asyncio.Event()
        transport, _ = await loop.create_unix_connection(lambda: _Connection(self, lost), str(self._socket))
        self._transport, self._trouble, self._heard_s = transport, "", loop.time()
        try:
            while not lost.is_set():
                with contextlib.suppress(TimeoutError):
                    async with asyncio.timeout(TICK_S):
                        await lost.wait()
                now = loop.time()
                self._ears.look(now)
                if now - self._heard_s > self._silence_s:
                    self._trouble = f"it says nothing for {self._silence_s:g} s"
                    break
        finally:
            transport.abort()
            self._lose(self._trouble or "its connection ended")

    def _lose(self, reason: str) -> None:
        self._trouble, self._transport, self.told, self.epoch = reason, None, None, 0
        for asked in self._asked.values():
            if not asked.done():
                asked.set_exception(NotConnected(reason, device="guard"))
        self.on_lost(reason)
        self._ears.down(reason)

    # ------------------------------------------------------------ what comes

    def received(self, kind: Kind, body: bytes) -> None:
        """One message of the guard. Raises GuardMessageError, KeyError, TypeError."""
        self._heard_s = asyncio.get_running_loop().time()
        match kind:
            case Kind.FRAME:
                self._ears.heard(wire.decode_frame(body)[0], self._heard_s)
            case Kind.ANSWER:
                values = wire.decode_object(body)
                asked = self._asked.get(int(values["tag"]))
                if asked is None or asked.done():
                    return
                if "error" in values:
                    asked.set_exception(error_of(values["error"], values["reason"], values["device"]))
                else:
                    asked.set_result(values["is"])
            case Kind.STATE:
                self._state(Told(**wire.decode_object(body)))

    def _state(self, told: Told) -> None:
        before, self.told = self.told, told
        self.on_told(told)
        self._news.set()
        if told.bus and before is not None and not before.bus:
            self._ears.down(told.bus)

    # ------------------------------------------------------------ what goes

    def beat(self) -> None:
        """This controller lives."""
        if self._transport is not None:
            self._transport.write(wire.encode(Kind.BEAT))

    def send(self, frame: CanFrame) -> None:
        """One frame for the drives. Raises NotConnected where it certainly does not reach them."""
        told, transport = self.told, self._transport
        if told is None or transport is None:
            raise NotConnected(f"no guard: {self._trouble}", device="guard")
        if told.bus:
            raise NotConnected(f"no CAN adapter: {told.bus}", device="guard")
        if not may_pass(frame, told.tripped):
            raise NotConnected(f"the guard lets nothing pass that moves: {told.reason}", device="guard")
        transport.write(wire.encode_frame(frame, self.epoch))

    def subscribe(self, can_id: int, listener: Listener) -> Callable[[], None]:
        """See `hal.bus.ears.Link`."""
        return self._ears.subscribe(can_id, listener)

    def watch(self, can_id: int, within_s: float, lost: Callable[[], None]) -> Callable[[], None]:
        """See `hal.bus.ears.Link`."""
        return self._ears.watch(can_id, within_s, lost, asyncio.get_running_loop().time())

    async def call(self, do: str, **values: Any) -> dict[str, Any]:
        """Ask the guard for something. Raises what it answers, NotConnected, DeviceTimeout."""
        if self._transport is None:
            raise NotConnected(f"no guard: {self._trouble}", device="guard")
        self._tag += 1
        asked: asyncio.Future[dict[str, Any]] = asyncio.get_running_loop().create_future()
        self._asked[tag := self._tag] = asked
        self._transport.write(wire.encode_object(Kind.CALL, {"tag": tag, "do": do} | values))
        try:
            async with asyncio.timeout(ANSWER_S):
                return await asked
        except TimeoutError:
            device = str(values.get("device", "guard"))
            raise DeviceTimeout(f"the guard gives no answer to {do} within {ANSWER_S:g} s", device=device) from None
        finally:
            del self._asked[tag]


class _Connection(asyncio.Protocol):
    def __init__(self, link: GuardLink, lost: asyncio.Event) -> None:
        self._link, self._lost = link, lost
        self._rest = b""

    def data_received(self, data: bytes) -> None:
        if self._lost.is_set():
            return
        try:
            messages, self._rest = wire.split(self._rest + data)
            for kind, body in messages:
                self._link.received(kind, body)
        except (GuardMessageError, KeyError, TypeError):
            self._lost.set()

    def connection_lost(self, error: Exception | None) -> None:
        self._lost.set()
