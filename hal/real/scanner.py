"""Scanner by file drop, `hal.interfaces.Scanner`: the scanner's own software watches a folder and answers there.

Requests are numbered and an answer names its request, so a late one is never taken for another. Frames are given as
the scanner made them: half empty, all invalid or too small ones are for the measurement to judge. A frame whose id has
not grown is an old frame and keeps the time of the newest one before it.
"""

from __future__ import annotations

import asyncio
import re
import time

import numpy as np
from numpy.typing import NDArray

from hal.bus.folder import Folder
from hal.codec import scan_drop as drop
from hal.codec.cloud_arrays import LARGEST_FILE
from hal.entries import FileDropEntry
from hal.errors import DeviceFault, DeviceRefused, DeviceTimeout, ImplausibleReading, Interrupted, NotConnected
from hal.interfaces import Frame, Identity, SafeState, View

SIMULATOR = "cellctl"
"""What a simulator calls its vendor."""
_OURS = re.compile(r"(\d{8,})\.(?:request\.json|answer\.json|npz|npy|ply|pcd)")
_FAILURES = {"refused": DeviceRefused, "fault": DeviceFault, "interrupted": Interrupted}


class FileDropScanner:
    """No task of its own: whoever asks looks for the answer every `poll_s`."""

    def __init__(self, name: str, entry: FileDropEntry) -> None:
        self._name = name
        self._entry = entry
        self._folder = Folder(entry.folder, entry.reply_s)
        self._number = 0
        self._connected = False
        self._capturing = False
        self._last: Frame | None = None

    @property
    def name(self) -> str:
        """Name in the cell file."""
        return self._name

    async def connect(self) -> Identity:
        """Who answers in the folder; what an earlier controller left there is taken away.

        Raises NotConnected (no folder), DeviceTimeout (nobody answers), DeviceRefused (not the one of the cell file).
        """
        if not self._connected:
            self._folder.open()
            await self._tidy()
        told = await self._ask("identify")
        assert isinstance(told, drop.IdentityTold)
        if self._entry.serial and told.serial != self._entry.serial:
            raise DeviceRefused(f"scanner {told.serial} answers, {self._entry.serial} is meant", device=self._name)
        self._connected = True
        return Identity(told.vendor, told.model, told.serial, told.firmware, simulated=told.vendor == SIMULATOR)

    async def close(self) -> None:
        """Nothing is asked any more; a capture in flight ends with NotConnected."""
        self._connected = False
        await self._folder.close()

    async def halt(self) -> None:
        """End a capture in flight, which raises Interrupted there; returns once the projector is dark."""
        told = await self._command("halt")
        if told.projecting:
            raise DeviceFault("the projector is lit after a halt", device=self._name)

    async def safe(self) -> SafeState:
        """Safe while the projector is dark."""
        told = await self._command("state")
        return SafeState(not told.projecting, "projecting" if told.projecting else "projector dark")

    async def rearm(self) -> None:
        """Nothing is resumed: a capture that is still under way, and that nobody waits for any more, is ended."""
        await self.halt()

    async def capture(self, view: View) -> Frame:
        """One organised cloud.

        Raises DeviceRefused (not in the view, another capture in flight), DeviceFault (the scanner says so, half a
        file), DeviceTimeout (no frame), ImplausibleReading (not in mm, another view), Interrupted (halted),
        NotConnected.
        """
        self._require("capture")
        if self._capturing:
            raise DeviceRefused("a capture is in flight", device=self._name)
        self._capturing = True
        try:
            return await self._capture(view)
        finally:
            self._capturing = False

    async def _capture(self, view: View) -> Frame:
        told = await self._ask("capture", view)
        seen_s = asyncio.get_running_loop().time()
        assert isinstance(told, drop.FrameTold)
        if told.unit != "mm":
            raise ImplausibleReading(f"frame {told.frame_id} is in {told.unit!r}, not in mm", device=self._name)
        if told.view != view:
            reason = f"frame {told.frame_id} shows {told.view!r}, asked for was {view!r}"
            raise ImplausibleReading(reason, device=self._name)
        points_mm = await self._cloud(told)
        time_s, last = seen_s - told.age_s, self._last
        if last is not None and told.frame_id <= last.frame_id:
            return Frame(told.frame_id, view, min(time_s, last.time_s), points_mm)
        self._last = Frame(told.frame_id, view, time_s, points_mm)
        return self._last

    async def _cloud(self, told: drop.FrameTold) -> NDArray[np.float32]:
        try:
            data = await self._folder.get(told.file, LARGEST_FILE)
            if data is None:
                raise DeviceFault(f"{told.file} was told, and is not there", device=self._name)
            points_mm = await self._folder.work(drop.decode_cloud, data, told)
        except drop.ScanDropError as error:
            raise DeviceFault(str(error), device=self._name) from None
        except TimeoutError:
            raise DeviceTimeout(f"{told.file} cannot be read in time", device=self._name) from None
        except OSError as error:
            raise NotConnected(str(error), device=self._name) from None
        finally:
            self._folder.discard(told.file)
        return points_mm

    # ------------------------------------------------------------ requests

    def _require(self, command: str) -> None:
        if not self._connected:
            raise NotConnected(f"not connected ({command})", device=self._name)

    async def _command(self, ask: drop.Ask) -> drop.StateTold:
        self._require(ask)
        told = await self._ask(ask)
        assert isinstance(told, drop.StateTold)
        return told

    async def _ask(self, ask: drop.Ask, view: str = "") -> drop.Answer:
        """The answer. Raises what it says, DeviceTimeout without one, NotConnected without the folder."""
        self._number += 1
        request = drop.Request(self._number, ask, view)
        deadline_s = self._entry.frame_s if ask == "capture" else self._entry.reply_s
        try:
            async with asyncio.timeout(deadline_s):
                await self._folder.put(request.stem + drop.REQUEST, drop.encode_request(request))
                answer = drop.decode_answer(await self._answer(request.stem), request)
        except TimeoutError:
            raise DeviceTimeout(f"no answer to {ask} within {deadline_s:g} s", device=self._name) from None
        except drop.ScanDropError as error:
            raise DeviceFault(f"answer to {ask}: {error}", device=self._name) from None
        except OSError as error:
            raise NotConnected(str(error), device=self._name) from None
        finally:  # also where nobody waits any more: what was not begun shall not be begun
            self._folder.discard(request.stem + drop.REQUEST, request.stem + drop.ANSWER)
        if isinstance(answer, drop.Failed):
            raise _FAILURES[answer.error](answer.reason, device=self._name)
        return answer

    async def _answer(self, stem: str) -> bytes:
        while True:
            data = await self._folder.get(stem + drop.ANSWER, drop.LARGEST_ANSWER)
            if data is not None:
                return data
            await asyncio.sleep(self._entry.poll_s)

    async def _tidy(self) -> None:
        """Take away what is left of earlier requests, and count on from them."""
        try:
            left = [found for name in await self._folder.names() if (found := _OURS.fullmatch(name))]
        except TimeoutError:
            raise DeviceTimeout(f"folder {self._entry.folder} does not answer", device=self._name) from None
        except OSError as error:
            raise NotConnected(str(error), device=self._name) from None
        # By the clock, so that an answer to an earlier controller that comes late answers nobody.
        by_clock = time.time_ns() // 10**7 % 10**8
        self._number = max([self._number, by_clock, *(int(found[1]) for found in left)])
        self._folder.discard(*(found[0] for found in left))
