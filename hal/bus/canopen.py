"""One CANopen node as the controller sees it: SDO transfers with a deadline, PDO image, heartbeat, emergencies.

A reply counts only for the request that it answers. After a transfer that ended without its reply, the next one first
reads another object: replies come in order, so that whatever was still on its way has passed by then.
"""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Callable, Mapping

from hal.bus.ears import Link
from hal.codec import sdo
from hal.codec.cia301 import (
    DEVICE_TYPE,
    EMCY,
    HEARTBEAT,
    SDO_REPLY,
    SDO_REQUEST,
    TPDO1,
    TPDO2,
    Emergency,
    Entry,
    Malformed,
    NmtCommand,
    NmtState,
    heartbeat_state,
    nmt,
    pack,
    unpack,
)
from hal.codec.cia402 import LAYOUTS
from hal.codec.lawicel import CanFrame
from hal.errors import DeviceError, DeviceFault, DeviceRefused, DeviceTimeout, NotConnected


class Node:
    """Node `number` on `link`; `name` is the device's in the cell file, for errors."""

    def __init__(self, link: Link, number: int, name: str, *, silence_s: float, reply_s: float) -> None:
        self.number = number
        self._link = link
        self._name = name
        self._silence_s = silence_s
        self._reply_s = reply_s
        self._ends: list[Callable[[], None]] = []
        self._turn = asyncio.Lock()
        self._request = b""
        self._reply: asyncio.Future[bytes] | None = None
        self._unsure = False
        self._news: asyncio.Future[None] | None = None
        self.tidings = 0
        """Grows with whatever may change what a command waits for: TPDO1, emergencies, boot-up, the link."""
        self.values: dict[Entry, int] = {}
        """The last value of each entry that a PDO brought: for showing and watching; commands ask."""
        self.emergency: Emergency | None = None
        """The last one; None once the node has said that there is no error."""
        self.lost = ""
        """Why the node is not heard; empty while it is, and before its first beat."""
        self._state: NmtState | None = None
        self.boots = 0
        """Boot-up messages since `open`: each means that what was set is lost."""

    # ------------------------------------------------------------ life

    @property
    def opened(self) -> bool:
        """Whether it takes part in the bus."""
        return bool(self._ends)

    async def open(self) -> None:
        """Take part in the bus. Raises NotConnected."""
        await self._link.open()
        functions = (TPDO1, TPDO2, EMCY, SDO_REPLY, HEARTBEAT)
        self._ends = [self._link.subscribe(function + self.number, self) for function in functions]
        self._ends.append(self._link.watch(HEARTBEAT + self.number, self._silence_s, self._silent))
        self.lost, self.boots, self.emergency, self._unsure = "", 0, None, True
        self.values.clear()

    async def close(self) -> None:
        """Leave the bus. Never raises."""
        for end in self._ends:
            end()
        self._ends = []
        self._give_up(NotConnected("closed", device=self._name))
        await self._link.release()

    # ------------------------------------------------------------ what comes

    def frame(self, frame: CanFrame) -> None:
        """One frame of this node. Malformed ones are dropped: the deadlines find out."""
        function = frame.can_id - self.number
        with contextlib.suppress(Malformed):
            match function:
                case int(function) if function == SDO_REPLY:
                    self._answered(frame.data)
                    return
                case int(function) if function == HEARTBEAT:
                    self._beat(heartbeat_state(frame.data))
                    return
                case int(function) if function == EMCY:
                    said = Emergency.decode(frame.data)
                    self.emergency = said if said.code else None
                case _:
                    self.values |= unpack(LAYOUTS[function], frame.data)
                    if function == TPDO2:
                        return
            self._tell()

    def down(self, reason: str) -> None:
        """The bus is lost."""
        self.lost = reason
        self._give_up(NotConnected(f"the bus is down: {reason}", device=self._name))

    def _silent(self) -> None:
        if self._state is NmtState.BOOT_UP:
            return  # it has said that it restarted, and knows of no heartbeat until it is told to
        self.lost = f"no heartbeat for {self._silence_s:g} s"
        self._give_up(NotConnected(self.lost, device=self._name))

    def _beat(self, state: NmtState) -> None:
        self._state = state
        boot = state is NmtState.BOOT_UP
        self.boots += boot
        if self.lost or boot:
            self.lost = ""
            self._tell()
        if boot:
            self._give_up(DeviceFault("restarted", device=self._name))

    def _answered(self, data: bytes) -> None:
        waiting = self._reply
        if waiting is not None and not waiting.done() and sdo.belongs(self._request, data):
            waiting.set_result(data)

    def _give_up(self, error: DeviceError) -> None:
        if self._reply is not None and not self._reply.done():
            self._reply.set_exception(error)
        self._tell()

    def _tell(self) -> None:
        self.tidings += 1
        if self._news is not None and not self._news.done():
            self._news.set_result(None)
        self._news = None

    async def news(self, since: int, within_s: float) -> None:
        """Until `tidings` is beyond `since`, or `within_s` has passed."""
        if self.tidings != since:
            return
        if self._news is None:
            self._news = asyncio.get_running_loop().create_future()
        await asyncio.wait({self._news}, timeout=within_s)

    # ------------------------------------------------------------ what goes

    def command(self, command: NmtCommand) -> None:
        """NMT command to this node, which is not acknowledged. Raises NotConnected."""
        self._send(nmt(command, self.number))

    def put(self, function: int, values: Mapping[Entry, int]) -> None:
        """Send an RPDO, which is not acknowledged. Raises NotConnected."""
        self._send(CanFrame(function + self.number, pack(LAYOUTS[function], values)))

    def _send(self, frame: CanFrame) -> None:
        try:
            self._link.send(frame)
        except NotConnected as error:
            raise NotConnected(error.reason, device=self._name) from None

    async def upload(self, entry: Entry) -> int:
        """Read one object. Raises NotConnected, DeviceTimeout, DeviceRefused (aborted)."""
        data = await self._transfer(sdo.upload(entry.index, entry.sub), str(entry))
        try:
            return entry.decode(data)
        except Malformed as error:
            raise DeviceFault(str(error), device=self._name) from None

    async def text(self, index: int) -> str:
        """A visible string; empty where the node has none, which is its right. Raises as `upload`."""
        try:
            data = await self._transfer(sdo.upload(index, 0), f"{index:#06x}:0")
        except DeviceRefused:
            return ""
        return data.rstrip(b"\0").decode("ascii", "replace")

    async def download(self, entry: Entry, value: int) -> None:
        """Write one object. Raises as `upload`."""
        await self._transfer(sdo.download(entry.index, entry.sub, entry.encode(value)), str(entry))

    async def set(self, entry: Entry, value: int) -> None:
        """Write one object and read it back. Raises as `upload`, and DeviceFault where it was not taken."""
        await self.download(entry, value)
        if (back := await self.upload(entry)) != value:
            raise DeviceFault(f"{entry} was set to {value} and reads {back}", device=self._name)

    async def _transfer(self, transfer: sdo.Transfer, what: str) -> bytes:
        async with self._turn:
            if self._unsure:
                await self._run(sdo.upload(DEVICE_TYPE.index, DEVICE_TYPE.sub), f"{what}, behind a missed reply")
                self._unsure = False
            return await self._run(transfer, what)

    async def _run(self, transfer: sdo.Transfer, what: str) -> bytes:
        self._unsure, unsure = True, self._unsure
        try:
            request = next(transfer)
            while True:
                request = transfer.send(await self._exchange(request, what))
        except StopIteration as done:
            self._unsure = unsure
            return bytes(done.value)
        except sdo.SdoAbort as error:
            self._unsure = unsure
            raise DeviceRefused(f"{what}: {error}", device=self._name) from None

    async def _exchange(self, request: bytes, what: str) -> bytes:
        if self.lost:
            raise NotConnected(self.lost, device=self._name)
        self._request, self._reply = request, asyncio.get_running_loop().create_future()
        try:
            async with asyncio.timeout(self._reply_s):
                self._send(CanFrame(SDO_REQUEST + self.number, request))
                return await self._reply
        except TimeoutError:
            if request[0] >> 5 in (0, 3):  # in the middle of a segmented transfer, which the server would go on with
                with contextlib.suppress(NotConnected):
                    self._send(CanFrame(SDO_REQUEST + self.number, sdo.abort(0, 0, sdo.TIMED_OUT)))
            raise DeviceTimeout(f"no answer within {self._reply_s:g} s ({what})", device=self._name) from None
        finally:
            self._reply = None
