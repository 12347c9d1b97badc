"""Simulator of a scanner's software that serves a folder (file drop), the fake scanner on the plant behind it."""

from __future__ import annotations

import asyncio
from collections.abc import Coroutine
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, cast

from hal.bus.folder import put_whole
from hal.codec import scan_drop as drop
from hal.errors import DeviceFault, DeviceRefused, DeviceTimeout, Interrupted
from hal.fake.devices.scanner import FakeScanner
from hal.fake.faults import FaultBook
from hal.interfaces import View

POLL_S = 0.02


@dataclass
class WireFaults:
    """What goes wrong in the folder; counts are of answers."""

    mute: int = 0
    """Requests that are carried out and not answered."""
    half_file: int = 0
    """Clouds of which only the first half was written."""
    half_answer: int = 0
    """Side files of which only the first half was written."""
    wrong_request: int = 0
    """Answers that name the request before."""
    no_cloud: int = 0
    """Side files that name a cloud which is not there."""
    unit: str = "mm"
    """What side files say."""
    view: str = ""
    """What side files say, where it is not what was asked for."""


class DropFolder:
    """The folder's other side. `scanner` must not act out faults of the link itself (see `behind.BehindWire`)."""

    def __init__(
        self,
        scanner: FakeScanner,
        faults: FaultBook,
        folder: Path,
        *,
        kind: drop.CloudKind = "npz",
        poll_s: float = POLL_S,
    ) -> None:
        self.name = scanner.name
        self.kind = kind
        self.folder = folder
        self.serial = f"{scanner.name}-1"
        self.wire = WireFaults()
        self.captures = 0
        """How often a capture was begun."""
        self._away = folder.with_name(f".{folder.name}.away")
        self._scanner = scanner
        self._faults = faults
        self._poll_s = poll_s
        self._tasks: set[asyncio.Task[None]] = set()

    async def start(self) -> None:
        """Serve the folder, which is made."""
        self.folder.mkdir(parents=True, exist_ok=True)
        self._spawn(self._watch())

    async def close(self) -> None:
        """Serve no more."""
        for task in self._tasks:
            task.cancel()
        if self._tasks:
            await asyncio.wait(self._tasks)
        await self._scanner.close()

    def unmount(self) -> None:
        """The folder is gone, as when the network is."""
        if self.folder.exists():
            self.folder.rename(self._away)

    def mount(self) -> None:
        """It is back with all that was in it."""
        if self._away.exists():
            self._away.rename(self.folder)

    def _spawn(self, work: Coroutine[Any, Any, None]) -> None:
        task = asyncio.get_running_loop().create_task(work, name=f"{self.name} folder")
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    async def _watch(self) -> None:
        loop = asyncio.get_running_loop()
        end_gone = self._faults.when(self.name, "gone", self.unmount)
        was_gone = False
        try:
            while True:
                gone = self._faults.active(self.name, "gone", loop.time()) is not None
                if was_gone and not gone:
                    self.mount()
                elif gone:
                    self.unmount()
                was_gone = gone
                self._look()
                await asyncio.sleep(self._poll_s)
        finally:
            end_gone()

    def _look(self) -> None:
        """Begin whatever is asked."""
        if not self.folder.is_dir() or self._faults.active(self.name, "hung", asyncio.get_running_loop().time()):
            return
        for path in sorted(self.folder.glob(f"*{drop.REQUEST}")):
            try:
                request = drop.decode_request(path.read_bytes())
                path.unlink()
            except (OSError, drop.ScanDropError):
                continue  # withdrawn meanwhile, or nobody's
            self._spawn(self._serve(request))

    async def _serve(self, request: drop.Request) -> None:
        if late := self._faults.active(self.name, "late", asyncio.get_running_loop().time()):
            await asyncio.sleep(late.number)
        try:
            answer = await self._obey(request)
        except DeviceTimeout:
            return  # no frame: nothing comes
        except DeviceRefused as error:
            answer = drop.Failed("refused", error.reason)
        except DeviceFault as error:
            answer = drop.Failed("fault", error.reason)
        except Interrupted as error:
            answer = drop.Failed("interrupted", error.reason)
        self._tell(request, answer)

    async def _obey(self, request: drop.Request) -> drop.Answer:
        match request.ask:
            case "identify":
                return drop.IdentityTold("cellctl", "twin structured light", self.serial, "1")
            case "capture":
                return await self._capture(request)
            case "halt":
                await self._scanner.halt()
                await asyncio.sleep(self._poll_s)  # the projector goes dark
        return drop.StateTold(not (await self._scanner.safe()).safe)

    async def _capture(self, request: drop.Request) -> drop.FrameTold:
        self.captures += 1
        frame = await self._scanner.capture(cast(View, request.view))
        data = drop.encode_cloud(frame.points_mm, self.kind)
        age_s = asyncio.get_running_loop().time() - frame.time_s
        rows, columns = frame.points_mm.shape[:2]
        file = f"{request.stem}.{self.kind}"
        told = drop.FrameTold(frame.frame_id, frame.view, self.wire.unit, age_s, file, len(data), (rows, columns))
        if self.wire.no_cloud:
            self.wire.no_cloud -= 1
            return told
        if self.wire.half_file:
            self.wire.half_file -= 1
            data = data[: len(data) // 2]
        self._put(file, data)
        return replace(told, view=self.wire.view) if self.wire.view else told

    def _tell(self, request: drop.Request, answer: drop.Answer) -> None:
        if self.wire.mute:
            self.wire.mute -= 1
            return
        number = request.number
        if self.wire.wrong_request:
            self.wire.wrong_request -= 1
            number -= 1
        data = drop.encode_answer(number, answer)
        if self.wire.half_answer:
            self.wire.half_answer -= 1
            data = data[: len(data) // 2]
        self._put(request.stem + drop.ANSWER, data)

    def _put(self, name: str, data: bytes) -> None:
        if self.folder.is_dir():
            put_whole(self.folder / name, data)
