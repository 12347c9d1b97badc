"""Whole small assemblies over the wire, each with one fault on it: `python -m tests.journeys.wire_faults [NUMBER ...]`.

Where the run is held, the fault passes and an operator clears the cell; it must then be ready again. A number alone
repeats its run: the case is the number modulo how many there are, the rest is drawn from it.
"""

from __future__ import annotations

import asyncio
import logging
import sys
import tempfile
import time
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from random import Random

from cellctl.controller import Controller
from cellctl.gun_programs import programs_of
from cellctl.runner import ENDED, Composed, RunRequest, compose
from cellctl.safety_watch import watch_safety
from cellctl.states import Command, State
from cellctl.twin import truth_limits, twin_of
from hal.cell import CellFailure
from hal.clock import QuickenedLoop
from hal.codec import cia301 as cia
from hal.codec.open_protocol_messages import INPUT_SET
from hal.config import CellConfig
from hal.fake.devices.guns import joints_of
from hal.fake.plant import Plant
from hal.fake.truth import truth_of
from hal.fake.wire.stand import standing
from tests.journeys import wire_strikes as do
from tests.journeys.stops import brisk_recipe
from tests.journeys.twin_runs import RememberedJobs
from tests.journeys.wire_judge import Begun, Ended, told_by, witness, wrong
from tests.journeys.wire_runs import CATCH_UP_S, wire_cell
from tests.journeys.wire_strikes import JACK, Strike, Wires

SPEED = 15.0
STALE_MS = 1000.0
"""Slow and patient enough for bytes of a pseudo-terminal to come in time on a desk that is busy with other things."""
BRISK = {"pdo_s": 1.0, "heartbeat_s": 1.0, "rate_hz": 100.0}
GUN_RATE_HZ = 25.0
"""Fewer messages than in a hall, for a loop that is to run fast."""
LONGEST_S = 3000.0
"""Cell seconds that a run may take, whatever happens to it."""
BACK_S = 120.0
"""Cell seconds within which the cell is ready again once the fault is over and an operator asks for it."""
LOOK_S = 0.02
CONNECTS = 5


@dataclass(frozen=True, slots=True)
class Case:
    """One fault: within `within_s` of the beginning of `phase`, or, where `starts` is given, while gun a turns in one
    of its first `starts` programs. `blames`: what a reason must name where the run is held. `goes_on`: it must not be.
    """

    name: str
    phase: str
    strike: Strike
    blames: tuple[str, ...]
    within_s: float = 0.0
    starts: int = 0
    goes_on: bool = False


DRIVES = tuple(f"{name}:" for name in ("jack", "stage_x", "stage_y", "shaft_table", "gun_table", "gun_feed"))
COUPLERS = ("chuck", "camera_park", "nut_feeder", "gap_probe", "safety", "part_station")
SENSORS = ("spigot_tc_1", "spigot_tc_2", "rotor_tc", "pyrometer")
TO_JACK = cia.SDO_REPLY + JACK, cia.SDO_REPLY + JACK
FROM_JACK = cia.TPDO1, cia.SDO_REPLY + JACK
CONTROLLER = cia.HEARTBEAT + 127, cia.HEARTBEAT + 127

CASES = (
    Case("CAN: cable pulled", "jack_up", do.can_unplugged(3.0), DRIVES, within_s=60.0),
    Case("CAN: adapter in bus-off", "tighten", do.can_bus_off, DRIVES, within_s=100.0),
    Case("CAN: half frames", "jack_up", do.can_frames("half", *FROM_JACK, 20), DRIVES, within_s=60.0),
    Case("CAN: late replies", "jack_up", do.can_frames("late", *TO_JACK, 2, 1.5), DRIVES, within_s=30.0),
    Case("CAN: duplicates", "align", do.can_frames("twice", 0, 0x7FF, 2000), DRIVES, within_s=1.0, goes_on=True),
    Case("CAN: wrong ids", "jack_up", do.can_wrong_ids, DRIVES, within_s=60.0, goes_on=True),
    Case("CAN: requests aborted", "jack_up", do.can_abort, ("jack:",), within_s=30.0),
    Case("CAN: emergency", "jack_up", do.can_emergency, ("jack:",), within_s=30.0),
    Case("CAN: a drive's heartbeat lost", "jack_up", do.can_muted(5.0), ("jack:",), within_s=60.0),
    Case("CAN: controller's heartbeat lost", "jack_up", do.can_frames("lost", *CONTROLLER, 5), DRIVES, within_s=60.0),
    Case("Modbus TCP: cable pulled", "tighten", do.modbus_unplugged("chuck", 3.0), COUPLERS, within_s=100.0),
    Case("Modbus TCP: exceptions", "heat", do.modbus_answers("heater", "exception", 3, 4), ("heater",), within_s=40.0),
    Case("Modbus TCP: heater unplugged", "heat", do.modbus_unplugged("heater", 8.0), ("heater",), within_s=40.0),
    Case("Modbus TCP: duplicates", "heat", do.modbus_answers("heater", "duplicate", 5), ("heater",), within_s=40.0),
    Case("Modbus RTU: adapter gone", "heat", do.modbus_unplugged("rotor_tc", 3.0), SENSORS, within_s=40.0),
    Case("Modbus RTU: late reply", "heat", do.modbus_answers("rotor_tc", "late", 1, 2.0), SENSORS, within_s=40.0),
    Case("Modbus RTU: wrong id", "heat", do.modbus_answers("rotor_tc", "wrong_unit", 2), SENSORS, within_s=40.0),
    Case("Modbus RTU: half frames", "heat", do.modbus_answers("rotor_tc", "half", 2), SENSORS, within_s=40.0),
    Case("gun: cable pulled", "tighten", do.gun_unplugged(20.0), ("gun a", "gun_a"), starts=6),
    Case("gun: connection dropped", "tighten", do.gun_dropped, ("gun a", "gun_a"), starts=6, goes_on=True),
    Case("gun: result lost", "tighten", do.gun_result_lost, ("gun a", "gun_a"), starts=6, goes_on=True),
    Case("gun: results twice", "tighten", do.gun_results_twice, ("gun a", "gun_a"), starts=6, goes_on=True),
    Case("gun: results late", "tighten", do.gun_results_late, ("gun a", "gun_a"), starts=6, goes_on=True),
    Case("gun: half messages", "tighten", do.gun_in_pieces, ("gun a", "gun_a"), starts=6, goes_on=True),
    Case("gun: results of others", "tighten", do.gun_strange_results, ("gun a", "gun_a"), starts=6, goes_on=True),
    Case("gun: start not answered", "tighten", do.gun_mute(INPUT_SET), ("gun a", "gun_a"), starts=6),
    Case("gun: power cycled", "tighten", do.gun_power_cycled, ("gun a", "gun_a"), starts=6),
    Case("force: cable pulled", "jack_up", do.force_unplugged("jack_force", 3.0), ("jack_force",), within_s=60.0),
    Case(
        "force: half lines",
        "jack_up",
        do.force_lines("jack_force", "half", 3),
        ("jack_force", "force sensor"),
        within_s=60.0,
    ),
    Case("force: gun's cable pulled", "tighten", do.force_unplugged("gun_force_a", 5.0), ("gun_force_a",), starts=2),
    Case("scanner: folder gone", "scan", do.scans_unmounted(10.0), ("scanner",), within_s=40.0),
    Case("scanner: answer to another request", "scan", do.scans_spoilt("wrong_request"), ("scanner",), within_s=30.0),
    Case("scanner: half a cloud", "scan", do.scans_spoilt("half_file"), ("scanner",), within_s=30.0),
)


def run_of(number: int) -> tuple[str, str]:
    """A word for the tally, and what is wrong, or empty."""
    case = CASES[number % len(CASES)]
    return judged(case, ended_of(case, number))


def ended_of(case: Case, number: int) -> Ended:
    """The run of that number."""
    with tempfile.TemporaryDirectory(prefix="wire-", dir="/tmp") as folder:
        return _quickened(case, number, Path(folder))


def judged(case: Case, ended: Ended) -> tuple[str, str]:
    """As `run_of`."""
    word = "goes on" if ended.verdict == "accepted" else ended.state
    return f"{case.name}: {word}", "; ".join(wrong(ended, case.blames, goes_on=case.goes_on))


def _quickened(case: Case, number: int, folder: Path) -> Ended:
    with asyncio.Runner(loop_factory=partial(QuickenedLoop, SPEED, CATCH_UP_S)) as runner:
        return runner.run(struck(case, number, folder))


def brisk_wire_cell(folder: Path) -> CellConfig:
    """The wire cell with few messages."""
    config = wire_cell(folder, **BRISK)
    slow = {"rate_hz": GUN_RATE_HZ}
    guns = {name: config.entries[name].model_copy(update=slow) for name in ("gun_force_a", "gun_force_b")}
    guard = config.guard.model_copy(update={"stale_ms": STALE_MS})
    return config.model_copy(update={"devices": config.devices.model_copy(update=guns), "guard": guard})


async def struck(case: Case, number: int, folder: Path) -> Ended:
    """One run with the fault of `case` on it."""
    recipe, config, jobs = brisk_recipe(), brisk_wire_cell(folder), RememberedJobs()
    seed = 1 + number // len(CASES)
    twin = twin_of(recipe, config, jobs, seed=seed)
    begun = witness(joints_of(twin.plant))
    async with standing(config, twin.plant, twin.faults, twin.render, programs_of(recipe.tighten)) as stand:
        made = compose(RunRequest(recipe, config, seed, folder / "data", keep="none", jobs=jobs))
        wires = Wires(stand, config, Random(number))
        try:
            await _connected(made)
            striking = asyncio.create_task(_strike(case, wires, made.controller, twin.plant, begun))
            async with asyncio.timeout(LONGEST_S):
                state = await _to_the_end(made)
                why = made.controller.snapshot().why
                hit = await _over(striking)
                after = "" if state is State.COMPLETE else await ready_again(made.controller)
        finally:
            await made.controller.shutdown()
            await made.twin.cell.close()
        truth = truth_of(twin.plant, truth_limits(recipe))
    summary = await made.store.get(made.assembly.run_id)
    record = made.store.record_path(made.assembly.run_id)
    rows, faults = told_by(record) if record is not None else ((), ("no record was sealed",))
    reasons = tuple(dict.fromkeys([*summary.reasons, *([why] if why else [])]))
    verdict = summary.verdict or "held"
    return Ended(state.value, verdict, reasons, truth.reasons, tuple(begun), rows, faults, after, hit)


async def _connected(made: Composed) -> None:
    """All devices, tried again as an operator does: a pseudo-terminal may still be in use by its last owner."""
    for left in reversed(range(CONNECTS)):
        try:
            await made.connect()
            return
        except CellFailure:
            if not left:
                raise
        await asyncio.sleep(5.0)


async def _to_the_end(made: Composed) -> State:
    """Reset, start, wait, the safety inputs being watched as in the service."""
    controller = made.controller
    controller.request(Command.RESET)
    await controller.until(State.IDLE)
    watch = asyncio.create_task(watch_safety(controller, made.twin.cell.until_unsafe))
    try:
        controller.start(made.assembly)
        return await controller.until(*ENDED)
    finally:
        watch.cancel()
        await asyncio.wait({watch})


async def _strike(case: Case, wires: Wires, controller: Controller, plant: Plant, begun: list[Begun]) -> None:
    """Wait for the moment, then do it."""
    while controller.snapshot().phase != case.phase:  # noqa: ASYNC110  # the run sets no event of ours
        await asyncio.sleep(LOOK_S)
    if case.starts:
        wanted, gun = wires.draw.randint(1, case.starts), joints_of(plant).guns["a"]
        while sum(one.gun == "gun_a" for one in begun) < wanted or gun.active is None:  # noqa: ASYNC110  # nor the gun
            await asyncio.sleep(LOOK_S)
        left_s = max(gun.active.end_s - asyncio.get_running_loop().time(), 0.0)
        await asyncio.sleep(wires.draw.uniform(0.0, 0.9 * left_s))
    else:
        await asyncio.sleep(wires.draw.uniform(0.0, case.within_s))
    if controller.state is State.EXECUTE:
        await case.strike(wires)
    else:
        raise asyncio.CancelledError


async def _over(striking: asyncio.Task[None]) -> bool:
    """Whether the fault was there, and is over."""
    done, _ = await asyncio.wait({striking}, timeout=BACK_S)
    if not done:
        striking.cancel()
        await asyncio.wait({striking})
    if striking.cancelled():
        return False
    striking.result()
    return True


async def ready_again(controller: Controller) -> str:
    """What an operator does with a run that is held or aborted; the state that it leads to, or what is against it."""
    end_s = asyncio.get_running_loop().time() + BACK_S
    ways = {State.HELD: Command.STOP, State.ABORTED: Command.CLEAR, State.STOPPED: Command.RESET}
    while (state := await controller.until(State.IDLE, *ways)) is not State.IDLE:
        if asyncio.get_running_loop().time() > end_s:
            return f"{state.value}: {controller.snapshot().why}"
        if ways[state] in controller.allowed():
            controller.request(ways[state])
        await asyncio.sleep(1.0)
    return state.value


def main(argv: list[str]) -> int:
    """The command."""
    logging.disable(logging.CRITICAL)
    bad = 0
    for number in map(int, argv) if argv else range(len(CASES)):
        begun_s, case = time.process_time(), CASES[number % len(CASES)]
        ended = ended_of(case, number)
        word, reason = judged(case, ended)
        bad += bool(reason)
        print(f"{number} {word} ({time.process_time() - begun_s:.0f} s of CPU)", flush=True)
        print(f"   said: {'; '.join(ended.reasons)}\n   wrong: {reason}", flush=True)
    return 3 if bad else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
