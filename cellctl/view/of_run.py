"""The page of a run's scans, from its journal and the clouds that were kept. Nothing is measured again."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Literal

import numpy as np

from cellctl.recipe import Recipe
from cellctl.records.blobs import is_kept, load
from cellctl.records.canonical import number_of
from cellctl.records.chain import Row
from cellctl.records.errors import ScanNotKept, ScanUnknown
from cellctl.records.journal import read_rows
from cellctl.records.scans import RunScan, run_scans
from cellctl.records.summary import summarise, value_of
from cellctl.view.page import Look, page

Side = Literal["rotor", "shaft"]
SIDES: tuple[Side, ...] = ("rotor", "shaft")
Clouds = Callable[[str], Mapping[str, Any]]
"""Arrays of a blob by its content hash. Raises RecordCorrupt, or ScanNotKept where the policy dropped it."""


def page_in(folder: Path, sides: tuple[Side, ...], frame_id: int | None) -> bytes:
    """`page_of` for the run in `folder`, UTF-8. Blocking, a second of work. Raises as `page_of`, RecordCorrupt."""

    def cloud(digest: str) -> Mapping[str, Any]:
        if not is_kept(folder / "blobs", digest):
            raise ScanNotKept("the scan was measured, but its cloud is not kept")
        return load(folder / "blobs", digest)

    return page_of(read_rows(folder / "journal.sqlite"), cloud, sides=sides, frame_id=frame_id).encode()


def page_of(
    rows: tuple[Row, ...], clouds: Clouds, *, sides: tuple[Side, ...] = SIDES, frame_id: int | None = None
) -> str:
    """The newest measured scan of each of `sides`, or the one with that frame id, as a page.

    With both sides the last alignment stands beside them. Raises ScanUnknown where none of them was measured, and
    ScanNotKept where the cloud of one that was is gone.
    """
    scans = [scan for scan in run_scans(rows) if scan.view in sides and frame_id in (None, scan.frame_id)]
    newest = {scan.view: scan for scan in scans if scan.placed}
    if not newest:
        raise ScanUnknown("the run has no such scan that was measured")
    header = value_of(rows, "run") or {}
    recipe = Recipe.model_validate_json(json.dumps(header["recipe"]))
    looks = [_look(side, newest[side], recipe, clouds) for side in SIDES if side in newest]
    summary = summarise(rows)
    facts = [
        ("order", summary.job_order_id),
        ("parts", f"rotor {summary.rotor_serial}, shaft {summary.shaft_serial}"),
        ("recipe", f"{summary.recipe} version {summary.recipe_version}"),
        ("run", f"{summary.state}, {summary.verdict or 'no verdict'}"),
        ("calibration", str(header.get("calibration_id", ""))),
    ]
    alignment = _alignment(rows) if len(looks) == len(SIDES) else None
    title = f"Scans of {summary.run_id}"
    return page(looks, np.random.default_rng(0), title=title, facts=facts, alignment=alignment)


def _alignment(rows: tuple[Row, ...]) -> dict[str, Any] | None:
    """The last alignment, with numbers where canonical JSON has words for those that are not finite."""
    value = value_of(rows, "alignment")
    if value is None:
        return None
    lists = {name: [number_of(each) for each in item] for name, item in value.items() if name.startswith("clearance")}
    numbers = {name: number_of(item) for name, item in value.items() if isinstance(item, int | float | str)}
    return {**numbers, "clocking_free": value.get("clocking_free"), **lists}


def _look(side: Side, scan: RunScan, recipe: Recipe, clouds: Clouds) -> Look:
    measured = scan.measurement()
    assert measured is not None, "chosen so"
    points = next(iter(clouds(scan.blob).values()))
    return Look(
        side, measured.part, recipe.part(side), points, measured.T_cell_scanner, f"frame {scan.frame_id}, {scan.utc}"
    )
