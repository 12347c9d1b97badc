"""What may be served how: a quickened clock is for fakes, the demo's sign-in for this machine and devices that say,
once connected, that they are simulated (`cellctl.workplace`)."""

from __future__ import annotations

import asyncio
import ipaddress
from dataclasses import dataclass
from pathlib import Path

from hal.clock import QuickenedLoop
from hal.config import CellConfig
from hal.errors import ConfigError


@dataclass(frozen=True, slots=True)
class Settings:
    """How the service is started. `speed` is cell seconds per second of the wall; port 0 takes a free one."""

    cell: Path
    data: Path
    recipes: Path
    host: str = "127.0.0.1"
    port: int = 8080
    speed: float = 1.0


def refuse_unfit(settings: Settings, config: CellConfig) -> None:
    """Raises ConfigError where these settings must not be used with this cell."""
    real = real_devices(config)
    if settings.speed != 1.0 and real:
        raise ConfigError(
            f"the clock may only be quickened where every device is fake; these are not: {', '.join(real)}",
            place="--speed",
            limit="1",
        )
    if not 0.01 <= settings.speed <= 1000.0:
        raise ConfigError(f"{settings.speed:g} is out of range", place="--speed", limit="0.01 to 1000")
    if config.auth.mode == "demo" and not loopback(settings.host):
        raise ConfigError(f"demo is for this machine only, {settings.host} is not", place="--host")


def real_devices(config: CellConfig) -> list[str]:
    """Names of the devices that are not fake."""
    return [name for name, kind in config.kinds.items() if kind != "fake"]


def clock(speed: float, config: CellConfig) -> asyncio.AbstractEventLoop:
    """An event loop: of fakes at `speed`, and standing still while heavy jobs are in flight; of real devices the
    machine's own, which never stands."""
    return asyncio.SelectorEventLoop() if real_devices(config) else QuickenedLoop(speed)


def loopback(host: str) -> bool:
    """Whether `host` is this machine and nothing else. A name other than localhost is not believed."""
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False
