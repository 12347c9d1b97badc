"""What the tests of the records share: a journal in virtual time and rows of a small run."""

from __future__ import annotations

import asyncio
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from cellctl.recipe import load_recipe
from cellctl.records.blobs import BlobStore, HashOnly
from cellctl.records.journal import Journal
from cellctl.records.ledger import JournalLedger
from cellctl.records.summary import RunHeader
from cellctl.stamps import VirtualStamps
from hal.interfaces import Frame, Identity, View


@dataclass(frozen=True)
class Desk:
    """A journal with its ledger."""

    journal: Journal
    ledger: JournalLedger
    blobs: BlobStore | HashOnly

    async def close(self) -> None:
        """Journal and blobs, and their threads."""
        await self.journal.close()
        await self.blobs.close()


async def desk(folder: Path | None = None, *, seed: int = 1, start: int = 0) -> Desk:
    """Journal and blobs in `folder`, or in memory."""
    stamps = VirtualStamps(seed, start=start)
    journal = await Journal.open(folder / "journal.sqlite" if folder else None, stamps)
    blobs = BlobStore(folder / "blobs") if folder else HashOnly()
    return Desk(journal, JournalLedger(journal, blobs, stamps), blobs)


@dataclass(frozen=True)
class Insertion:
    """As the step of that name gives it."""

    inserted: bool
    peak_total_n: float
    peak_bolt_n: float | None
    force_basis: str


@dataclass(frozen=True)
class Seating:
    """As the step of that name gives it."""

    seated: bool


@dataclass(frozen=True)
class HeatProof:
    """As the step of that name gives it."""

    reached_c: float
    spread_k: float
    samples: tuple[dict[str, float], ...]


def header(run_id: str = "run-1") -> RunHeader:
    """Header of a run of the 36-stud recipe."""
    recipe = load_recipe(Path(__file__).parents[2] / "recipes" / "lpt_shaft_36.toml")
    gun = Identity(vendor="twin", model="gun <a>", serial="1", firmware="1", simulated=True)
    return RunHeader(
        run_id=run_id,
        job_order_id="order-1",
        recipe=recipe,
        recipe_hash=recipe.content_hash,
        cell="fake-cell",
        calibration_id="fake-cell-1",
        calibration_hash="0" * 64,
        rotor_serial="R1",
        shaft_serial="S<1>",
        software="cellctl test",
        seed=7,
        level="nominal",
        devices={"gun_a": gun},
    )


async def captured(seed: int, view: View, key: str) -> Frame:
    """A small cloud of noise."""
    points = np.random.default_rng(seed).normal(size=(20, 30, 3)).astype(np.float32)
    return Frame(frame_id=seed, view=view, time_s=0.0, points_mm=points)


async def small_run(ledger: JournalLedger, *, verdict: str = "accepted") -> None:
    """Rows of a short run, from the scan to the verdict."""

    async def tighten(key: str) -> dict[str, object]:
        await asyncio.sleep(2.0)
        return {"torque_nm": 36.0}

    for seed, view in enumerate(("rotor", "rotor", "shaft")):
        await ledger.act("scanner", "capture", {"view": view}, partial(captured, seed, view))
        await asyncio.sleep(1.0)
    await ledger.note("measurement", {"side": "rotor"})
    await ledger.note("phase_scan", None)
    await ledger.note("phase_scan", Scans())
    await ledger.note("alignment", {"theta_deg": 0.01, "clearance_mm": [0.1, 0.2], "covariance_a": [[1.0, 0.0]]})
    await ledger.note("phase_align", Aligned())
    height = np.linspace(365.0, 396.0, 2000)
    await ledger.blob("force_curve", {"z_mm": height, "force_n": np.sin(height)})
    await ledger.note("phase_jack_up", Insertion(True, 3.5, None, "bounded_by_total"))
    samples = tuple({"time_s": 2.0 * i, "spigot_1_c": 20.0 + i, "rotor_c": 20.0} for i in range(50))
    await ledger.note("phase_heat", HeatProof(66.0, 1.0, samples))
    await ledger.note("phase_heat", Seating(True))
    for index in (0, 18):
        await ledger.act("gun_a", "tighten", {"joint": index}, tighten)
        joint = {"index": index, "gun": "a", "stage": "final", "torque_nm": 36.0, "angle_deg": 40.0, "verdict": "ok"}
        await ledger.note("joint", joint)
    await ledger.note("phase_tighten", Closure())
    await ledger.note("verdict", {"verdict": verdict, "reasons": [] if verdict == "accepted" else ["gap > 0.05 mm"]})


@dataclass(frozen=True)
class Scans:
    """As the step of that name gives it, without its numbers."""


@dataclass(frozen=True)
class Aligned:
    """As the step of that name gives it, without its numbers."""


@dataclass(frozen=True)
class Closure:
    """As the step of that name gives it, without its numbers."""
