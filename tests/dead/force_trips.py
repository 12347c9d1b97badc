"""Force at standstill after trips of the guard: `python -m tests.dead.force_trips --trips 10000 --seed 1`.

Parts that do not fit, in many ways, are inserted by the step itself; how long guard and bus take is drawn from what
was measured (`FOLDER/reaction_delays.json`, milliseconds, see tests.benchmarks.reaction). A number alone repeats its
insertion: seed, number and level are all that it is drawn from.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
from collections import Counter
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass, field, replace
from multiprocessing import get_context
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from cellctl.assembly import guard_plan
from cellctl.calibration import load_calibration
from cellctl.recipe import load_recipe
from cellctl.studies.figures import provenance
from cellctl.twin import geometry_of
from hal.clock import run_virtual
from hal.config import Level, load_cell
from hal.fake.contact.engagement import present_error
from hal.fake.motion import standing
from hal.fake.plant import Plant, TwinSettings
from tests.dead.trip_bench import Stage, Stopped, inserted

Array = NDArray[np.float64]
Misfit = Literal["shifted", "one stud", "some studs", "leaning"]

ROOT = Path(__file__).parents[2]
CELL = ROOT / "deploy" / "cell.wire.toml"
RECIPES = {"lpt_shaft_36": ROOT / "recipes" / "lpt_shaft_36.toml", "wire_bench": ROOT / "recipes" / "wire_bench.toml"}
LEVELS: tuple[Level, ...] = ("nominal", "hostile")
FILTER_S = (0.001, 0.002)
"""Of the amplifier: up to what the cell file says of the sensor."""
ADAPTER_S = (0.0, 0.001)
"""A serial adapter with its latency timer at 1 ms."""
MOST = 6
"""Studs that are out of place at once."""
PERCENTILES = {"p50_n": 50.0, "p99_n": 99.0, "max_n": 100.0}
WAYS = {"process": 1.0, "thread": 0.1, "open3d": 0.1}
"""How the guard runs, and the share of the trips that each is given: the threads are for contrast."""


@dataclass(frozen=True, slots=True)
class Trip:
    """One trip, and the insertion that it belongs to."""

    number: int
    level: Level
    misfit: Misfit
    stopped: Stopped


@dataclass
class Tally:
    """Forces at standstill of one level and way, newton."""

    level: Level
    way: str
    limit_n: float
    armed_n: float
    insertions: int = 0
    trips: list[Trip] = field(default_factory=list)

    def told(self) -> dict[str, Any]:
        """What goes into the figures."""
        force = np.array([trip.stopped.rest_n for trip in self.trips])
        worst = max(self.trips, key=lambda trip: trip.stopped.rest_n)
        return {
            "level": self.level,
            "way": self.way,
            "trips": len(force),
            "insertions": self.insertions,
            "armed_n": round(self.armed_n, 3),
            **{name: round(float(np.percentile(force, at)), 3) for name, at in PERCENTILES.items()},
            "limit_n": self.limit_n,
            "above": int((force > self.limit_n).sum()),
            "misfits": dict(Counter(trip.misfit for trip in self.trips)),
            "worst": {"number": worst.number, "misfit": worst.misfit} | asdict(worst.stopped),
        }


def reactions(path: Path, way: str) -> Array:
    """Measured seconds from a sample's last byte to the quick stop at the bus, of one `way`. Raises OSError."""
    return 1e-3 * np.array(json.loads(path.read_text(encoding="utf-8"))[way]["ms"], dtype=np.float64)


def campaign(
    level: Level, way: str, reaction_s: Array, *, trips: int, seed: int, recipe: str = "lpt_shaft_36"
) -> Tally:
    """`trips` of them, insertion after insertion."""
    read = load_recipe(RECIPES[recipe])
    tally = Tally(level, way, read.jack_up.force_limit_n, guard_plan(read, load_cell(CELL)).insert_trip_n)
    while len(tally.trips) < trips:
        tally.trips += tripped(tally.insertions, seed, level, reaction_s, recipe)
        tally.insertions += 1
    del tally.trips[trips:]
    return tally


def tripped(number: int, seed: int, level: Level, reaction_s: Array, recipe: str = "lpt_shaft_36") -> list[Trip]:
    """The trips of one insertion; none where the studs went in."""
    rng = np.random.default_rng((seed, number, LEVELS.index(level)))
    read, config = load_recipe(RECIPES[recipe]), load_cell(CELL)
    overrides = {"force_delay_s": rng.uniform(*FILTER_S)}
    plant = Plant(geometry_of(read), TwinSettings(int(rng.integers(2**31)), level, overrides), now=0.0)
    misfit = get_args(Misfit)[rng.integers(len(get_args(Misfit)))]
    _misfit(plant, misfit, rng)
    start_mm = _stand(plant, read.align.stand_off_mm + rng.uniform(-0.4, 0.5))

    def draw() -> Stage:
        return Stage(rng.uniform(*ADAPTER_S), float(rng.choice(reaction_s)))

    belief = load_calibration(config.calibration_path)
    stopped, _ = run_virtual(inserted(plant, read, config, belief, start_mm, draw))
    return [Trip(number, level, misfit, one) for one in stopped]


def _misfit(plant: Plant, misfit: Misfit, rng: np.random.Generator) -> None:
    """The shaft at its best pose but for what the gates leave; then something is not where it should be."""
    geometry = plant.geometry
    reach_mm = 0.5 * (geometry.hole_chamfer_diameter_mm - geometry.stud_tip_diameter_mm)
    error, left_mm = present_error(plant.dock()), rng.normal(0.0, 0.02, 2)
    _go(plant, left_mm[0] - error.x_mm, left_mm[1] - error.y_mm, rng.normal(0.0, 0.005) - error.theta_deg)
    if misfit == "shifted":
        way, turn_mm = _direction(rng), rng.uniform(-0.5, 0.5)
        x_mm, y_mm = rng.uniform(geometry.clearance_mm, 1.1 * reach_mm) * way
        _go(plant, x_mm, y_mm, math.degrees(turn_mm / (0.5 * geometry.circle_diameter_mm)))
        return
    count = 1 if misfit == "one stud" else int(rng.integers(1, min(MOST, geometry.count) + 1))
    studs = rng.choice(geometry.count, count, replace=False)
    ways = np.array([_direction(rng) for _ in studs])
    off_mm = rng.uniform(geometry.clearance_mm, 1.1 * reach_mm, (count, 1)) * ways
    place, slope = plant.rotor.stud_mm.copy(), plant.rotor.slope.copy()
    if misfit == "leaning":
        slope[studs] += off_mm / geometry.stud_length_mm * rng.uniform(0.5, 1.5)
    else:
        place[studs] += off_mm
    plant.rotor = replace(plant.rotor, stud_mm=place, slope=slope)


def _direction(rng: np.random.Generator) -> Array:
    angle = rng.uniform(0.0, 2.0 * math.pi)
    return np.array([math.cos(angle), math.sin(angle)])


def _go(plant: Plant, x_mm: float, y_mm: float, theta_deg: float) -> None:
    for name, by in (("stage_x", x_mm), ("stage_y", y_mm), ("shaft_table", theta_deg)):
        motion = plant.motion[name]
        motion.start(standing(motion.position(plant.now) + by, plant.now), plant.now)


def _stand(plant: Plant, stand_off_mm: float) -> float:
    """The shaft `stand_off_mm` below the studs; the jack's height."""
    dock = plant.dock()
    gap_mm = plant.geometry.stud_length_mm + stand_off_mm
    height = float(dock.motor_mm(dock.heights_mm(np.array([gap_mm])))[0])
    for motion in plant.motion.values():
        motion.homed = True
    plant.motion["jack"].start(standing(height, plant.now), plant.now)
    return height


def _row(level: Level, way: str, reaction_s: Array, numbers: dict[str, Any]) -> dict[str, Any]:
    return campaign(level, way, reaction_s, **numbers).told()


def main(argv: Sequence[str] | None = None) -> int:
    """The command. Exit 3 where the guard's process let a force beyond the limit pass."""
    parser = argparse.ArgumentParser(prog="python -m tests.dead.force_trips", description=__doc__)
    parser.add_argument("--trips", type=int, default=10_000, help="of each level")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--recipe", choices=sorted(RECIPES), default="lpt_shaft_36")
    parser.add_argument("--workers", type=int, default=2, help="processes")
    parser.add_argument("--figures", type=Path, default=ROOT / "docs" / "figures")
    parser.add_argument("--reaction-ms", type=float, nargs="+", help="instead of what was measured, for a look")
    args = parser.parse_args(argv)
    measured = args.figures / "reaction_delays.json"
    if args.reaction_ms is None and not measured.exists():
        parser.error(f"{measured} is missing: `python -m tests.benchmarks --only reaction` measures it")
    print(f"seed {args.seed}, recipe {args.recipe}", flush=True)
    rows = []
    with ProcessPoolExecutor(args.workers, get_context("spawn")) as pool:
        waiting = []
        for way, share in WAYS.items() if args.reaction_ms is None else (("given", 1.0),):
            reaction_s = reactions(measured, way) if args.reaction_ms is None else 1e-3 * np.array(args.reaction_ms)
            trips = max(round(share * args.trips), 1)
            numbers = {"trips": trips, "seed": args.seed, "recipe": args.recipe}
            waiting += [pool.submit(_row, level, way, reaction_s, numbers) for level in LEVELS]
        for row in (one.result() for one in waiting):
            print(json.dumps(row), flush=True)
            rows.append(row)
    if args.reaction_ms is None:
        command = ["python", "-m", "tests.dead.force_trips", *(argv or sys.argv[1:])]
        entry = provenance(command, ROOT) | {"seed": args.seed, "recipe": args.recipe, "rows": rows}
        path = args.figures / "force_trips.json"
        path.write_text(json.dumps(entry, indent=1, allow_nan=False) + "\n", encoding="utf-8")
    return 3 if any(row["above"] for row in rows if row["way"] not in ("thread", "open3d")) else 0


if __name__ == "__main__":
    sys.exit(main())
