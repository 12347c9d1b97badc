"""The peers as programs: where they are, which version they are, and how they are run. A missing one fails the test."""

from __future__ import annotations

import asyncio
import contextlib
import json
import shutil
import subprocess
from collections.abc import AsyncIterator
from importlib.metadata import version
from pathlib import Path

HERE = Path(__file__).parent
NPM = HERE / "npm"
MET: dict[str, str] = {}
"""Version of every peer that was met, by name; printed at the end of the session."""


def met_package(name: str) -> None:
    """A package from PyPI."""
    MET[f"{name} (PyPI)"] = version(name)


def npm_script(name: str) -> tuple[str, ...]:
    """The command that runs one of our scripts on npm canopen."""
    package = NPM / "node_modules" / "canopen" / "package.json"
    assert package.is_file(), "npm canopen is not installed (npm ci in tests/peers/npm)"
    MET["canopen (npm)"] = json.loads(package.read_text(encoding="utf-8"))["version"]
    return program("node"), str(NPM / name)


def program(name: str) -> str:
    """A program on the path."""
    found = shutil.which(name)
    assert found, f"{name} is not installed"
    return found


def met_debian(package: str) -> None:
    """A package of the system."""
    said = subprocess.run(
        [program("dpkg-query"), "-W", "-f", "${Version}", package], capture_output=True, text=True, check=False
    )
    assert said.returncode == 0, f"{package} is not installed"
    MET[f"{package} (Debian)"] = said.stdout


@contextlib.asynccontextmanager
async def running(*command: str) -> AsyncIterator[asyncio.subprocess.Process]:
    """A program with its input and output piped; it is killed where it has not ended by then."""
    process = await asyncio.create_subprocess_exec(
        *command, stdin=asyncio.subprocess.PIPE, stdout=asyncio.subprocess.PIPE
    )
    try:
        yield process
    finally:
        if process.returncode is None:
            process.kill()
        await process.wait()
        process._transport.close()  # type: ignore[attr-defined]  # its pipes, which nobody else closes


async def line_of(process: asyncio.subprocess.Process, within_s: float = 10.0) -> str:
    """The next line that it says."""
    assert process.stdout is not None
    async with asyncio.timeout(within_s):
        line = await process.stdout.readline()
    assert line, "the program has ended"
    return line.decode().strip()


async def said_by(*command: str, within_s: float = 20.0) -> tuple[int, str]:
    """Exit code and output of a program, errors included."""
    process = await asyncio.create_subprocess_exec(
        *command, stdout=asyncio.subprocess.PIPE, stderr=asyncio.subprocess.STDOUT
    )
    try:
        async with asyncio.timeout(within_s):
            out, _ = await process.communicate()
    finally:
        if process.returncode is None:
            process.kill()
            await process.wait()
    assert process.returncode is not None
    return process.returncode, out.decode()
