"""The page of a run: from the data folder, from the sealed record, and what is said where clouds are gone."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

import numpy as np
import pytest

from cellctl.records.blobs import load
from cellctl.records.errors import ScanNotKept, ScanUnknown
from cellctl.records.journal import read_rows
from cellctl.records.scans import run_scans
from cellctl.runner import RunRequest, run_once
from cellctl.view.of_run import SIDES, page_in
from cellctl.vision.residuals import FACE, THREAD, residuals
from tests.cli.shell import cellctl
from tests.journeys.twin_runs import FINE_CAMERA, SMALL, small_recipe, twin_cell


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of a run on the twin, its decision scans kept."""
    data = tmp_path_factory.mktemp("data")
    outcome = run_once(RunRequest(small_recipe(), twin_cell(), 3, data, keep="decision"))
    assert outcome.record is not None, outcome.reasons
    return outcome.record.parent


def test_the_journal_tells_every_scan_and_its_measurement(run: Path) -> None:
    scans = run_scans(read_rows(run / "journal.sqlite"))
    assert {"artefact_rotor", "artefact_shaft", "rotor", "shaft"} == {scan.view for scan in scans}
    assert [scan.frame_id for scan in scans] == list(range(1, len(scans) + 1))
    measured = [scan for scan in scans if scan.placed]
    assert [scan.view for scan in measured[:2]] == ["rotor", "shaft"] and len(measured) >= 3
    assert not any(scan.placed for scan in scans if scan.view.startswith("artefact"))


def test_a_kept_cloud_lies_on_its_measurement(run: Path) -> None:
    """The pose in the journal is the one the measurement was made with: residuals are the camera's noise."""
    recipe = small_recipe()
    for scan in run_scans(read_rows(run / "journal.sqlite")):
        measured = scan.measurement()
        if measured is None:
            continue
        side = "rotor" if scan.view == "rotor" else "shaft"
        assert measured.part.frame == "cell" and measured.part.found == SMALL
        grid = load(run / "blobs", scan.blob)["points_mm"]
        points = grid[np.isfinite(grid[..., 0])]
        found = residuals(points, measured.part, recipe.part(side), measured.T_cell_scanner)
        for kind in (FACE, THREAD) if side == "rotor" else (FACE,):
            off = found.distance_mm[found.surface == kind]
            assert len(off) > 300
            assert off.std() < 4.0 * FINE_CAMERA["scanner_noise_mm"], (scan.view, kind)


def test_both_sides_and_the_alignment(run: Path) -> None:
    html = page_in(run, SIDES, None).decode()
    assert html.count('<section class="side"') == 2 and "<h2>Alignment</h2>" in html
    assert f"Scans of {run.name}" in html
    assert f"all {SMALL} studs found" in html and f"all {SMALL} holes found" in html


def test_one_side_and_one_frame(run: Path) -> None:
    html = page_in(run, ("shaft",), 4).decode()
    assert html.count('<section class="side"') == 1 and "frame 4, 2000-01-01T" in html
    assert "<h2>Alignment</h2>" not in html
    newest = re.search(r"frame (\d+),", page_in(run, ("shaft",), None).decode())
    assert newest is not None and int(newest[1]) > 4


@pytest.mark.parametrize(("sides", "frame_id"), [(("shaft",), 3), (("rotor",), 1), (SIDES, 99)])
def test_what_was_not_measured_has_no_page(run: Path, sides: tuple[str, ...], frame_id: int) -> None:
    with pytest.raises(ScanUnknown):
        page_in(run, sides, frame_id)  # type: ignore[arg-type]  # one of SIDES each


def test_a_cloud_that_is_gone_is_told(run: Path, tmp_path: Path) -> None:
    copy = shutil.copytree(run, tmp_path / run.name)
    rotor = next(scan for scan in run_scans(read_rows(copy / "journal.sqlite")) if scan.view == "rotor")
    (copy / "blobs" / f"{rotor.blob}.npz").unlink()
    with pytest.raises(ScanNotKept, match="not kept"):
        page_in(copy, SIDES, None)
    assert b"Shaft" in page_in(copy, ("shaft",), None)


def test_the_report_command_writes_it_from_folder_and_record(run: Path, tmp_path: Path) -> None:
    names = [tmp_path / name for name in ("one.html", "other.html")]
    for source, view in zip((run.name, str(run / "record.zip")), names, strict=True):
        data = str(run.parent.parent)
        assert cellctl("report", source, "--data", data, "--out", str(tmp_path / "r.html"), "--view", str(view)) == 0
    assert names[0].read_bytes() == names[1].read_bytes() == page_in(run, SIDES, None)
