"""The end of phase tighten: the jack lets go, the probes look at the closed joint once more."""

from __future__ import annotations

from cellctl.ports import RunContext
from cellctl.steps.results import Closure
from cellctl.steps.seat import gaps


async def close_joint(run: RunContext) -> Closure:
    """Gap at three places and the jack's height, with all joints tight."""
    return Closure(gap_mm=await gaps(run), z_mm=(await run.devices.jack.read()).position)
