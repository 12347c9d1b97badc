"""The guard as a child of the controller: started again when it has died, ended with its parent."""

from __future__ import annotations

import asyncio
import contextlib
import subprocess
import sys
from pathlib import Path

from hal.clock import standing_still

ENDS_S = 3.0
"""An ordered end takes no longer."""


class GuardChild:
    """`python -m hal.guard` for one cell file. It ends by itself when this process does: its standard input closes."""

    def __init__(self, cell_file: Path) -> None:
        self._command = [sys.executable, "-m", "hal.guard", "--cell", str(cell_file), "--child"]
        self.process: subprocess.Popen[bytes] | None = None

    def ensure(self) -> None:
        """Start it unless it runs."""
        if self.process is not None and self.process.poll() is None:
            return
        self._let_go()
        # In a session of its own: Ctrl-C at a terminal goes to the controller, which needs its guard to the end.
        self.process = subprocess.Popen(self._command, stdin=subprocess.PIPE, start_new_session=True)

    async def close(self) -> None:
        """Let it end; one that does not is killed."""
        process = self.process
        if process is None:
            return
        self._let_go()
        with standing_still():
            await asyncio.get_running_loop().run_in_executor(None, _ended, process)

    def _let_go(self) -> None:
        if self.process is not None and self.process.stdin is not None:
            with contextlib.suppress(OSError):
                self.process.stdin.close()
        self.process = None


def _ended(process: subprocess.Popen[bytes]) -> None:
    try:
        process.wait(ENDS_S)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
