"""What goes over the wire. Requests are strict: unknown fields and silent conversions are refused."""

from __future__ import annotations

from datetime import datetime
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field

from hal.units import Deg, Fraction, NewtonMetre, Seconds

Count = Annotated[int, Field(json_schema_extra={"unit": "1"})]
Name = Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9._\-]{0,63}$")]


class Asked(BaseModel):
    """Base of what clients send."""

    model_config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False, frozen=True)


class Told(BaseModel):
    """Base of what the service answers."""

    model_config = ConfigDict(frozen=True)


class Serials(Asked):
    """Serial numbers of the two parts."""

    rotor: Name
    shaft: Name


class JobOrderRequest(Asked):
    """What the MES asks for: one joint of two parts by one version of one recipe."""

    job_order_id: Name
    recipe: Name
    recipe_version: Count = Field(ge=1, le=1_000_000)
    serials: Serials


class DryRunRequest(Asked):
    """An order to be tried on the twin. Without `seed` one is drawn."""

    recipe: Name
    recipe_version: Count = Field(ge=1, le=1_000_000)
    seed: Count | None = Field(default=None, ge=0, le=2**53)


class CommandRequest(Asked):
    """One command for the cell; `reason` is kept with it."""

    command: Literal["reset", "start", "hold", "unhold", "suspend", "unsuspend", "stop", "abort", "clear", "complete"]
    reason: str = Field(default="", max_length=200)


JobOrderState = Literal["NotAllowedToStart", "AllowedToStart", "Running", "Interrupted", "Ended", "Aborted"]


class JobOrder(Told):
    """A job order (ISA-95 states) and its run."""

    job_order_id: str
    state: JobOrderState
    run_id: str
    recipe: str
    recipe_version: Count
    serials: Serials
    received: datetime


class JobOrders(Told):
    """A page of orders, newest first. Ask again with `cursor` for the next page."""

    items: list[JobOrder]
    cursor: str | None


class Alarm(Told):
    """Something that is wrong; a latched one goes only with a successful clear."""

    code: str
    text: str
    latched: bool


class Progress(Told):
    """Where the run is. `fraction` is of the phase; `time_left_s` is of the whole run, in cell time, if known."""

    fraction: Fraction
    text: str
    time_left_s: Seconds | None


class UnsafeDevice(Told):
    """A device that is not proven safe."""

    device: str
    reason: str


class Cell(Told):
    """The cell at this instant. `event_sequence` is the last event that is in this answer already.

    `event_id` is the id of that event: given as Last-Event-ID it is known also across a restart of the service.
    """

    name: str
    simulated: bool
    state: str
    mode: Literal["Production"]
    why: str
    run_id: str | None
    job_order_id: str | None
    phase: str
    progress: Progress
    allowed_commands: list[str]
    alarms: list[Alarm]
    unsafe_devices: list[UnsafeDevice]
    in_state_s: Seconds
    event_sequence: Count
    event_id: str


class CommandTaken(Told):
    """The command was taken; the state is the one it leads through."""

    command: str
    state: str
    allowed_commands: list[str]


class Phase(Told):
    """One phase of a run (ISA-88)."""

    name: str
    state: str
    cell_time_s: Seconds


class Run(Told):
    """One execution. `state` is the cell's while it runs and the declared end after that."""

    run_id: str
    job_order_id: str | None
    recipe: str | None
    recipe_version: Count | None
    serials: Serials | None
    state: str
    verdict: str | None
    reasons: list[str]
    phases: list[Phase]
    started: datetime | None
    ended: datetime | None
    journal_hash: str | None
    sealed: bool
    simulated: bool


class Runs(Told):
    """A page of runs, newest first. Ask again with `cursor` for the next page."""

    items: list[Run]
    cursor: str | None


class JournalRow(Told):
    """One row of the journal, chained to the one before by `prev`."""

    seq: Count
    time_s: Seconds
    utc: str
    kind: str
    value: Any
    prev: str
    hash: str


class JournalPage(Told):
    """Rows in order. Ask again with `cursor` for the next page."""

    items: list[JournalRow]
    cursor: Count | None


class RunScan(Told):
    """One cloud of a run. `measured` says that it became a measurement, `refused` why it did not, where that was told.

    `kept` says that the cloud is still there, so that a page can be made of a measured one.
    """

    view: str
    frame_id: Count
    taken: datetime
    measured: bool
    refused: str | None
    kept: bool


class RunScans(Told):
    """Every cloud of a run, in the order in which they were taken."""

    items: list[RunScan]


class Joint(Told):
    """One joint in one stage; fields follow OPC 40451 in meaning. Null is a number that the gun never told."""

    index: Count
    gun: str
    stage: str
    torque_nm: NewtonMetre | None
    angle_deg: Deg | None
    verdict: str
    simulated: bool


BoltState = Literal["open", "partial", "ok", "nok", "unknown"]


class Bolt(Told):
    """What the results prove for one bolt: `ok` is every stage of the recipe and the verification, each once and OK.

    `angle_deg` is where it sits on its circle, right-handed about the outward normal of the shaft's face.
    """

    index: Count
    angle_deg: Deg
    state: BoltState


class Joints(Told):
    """All results of a run in the order in which they were made. `count` is the number of joints of the recipe.

    `bolts` has one entry for each joint of the recipe in the run's record, in the order of their indices.
    """

    count: Count | None
    items: list[Joint]
    bolts: list[Bolt] = []


class RecipeEntry(Told):
    """A recipe that may be ordered. `content_hash` is its ETag."""

    id: str
    version: Count
    title: str
    bolts: Count
    content_hash: str


class Recipes(Told):
    """All recipes, by id and version."""

    items: list[RecipeEntry]


class DryRun(Told):
    """A run on a private twin."""

    dry_run_id: str
    recipe: str
    recipe_version: Count
    seed: Count
    state: Literal["Running", "Ended", "Failed"]
    verdict: Literal["accepted", "rejected", "held"] | None
    reasons: list[str]
    cell_time_s: Seconds | None


class DryRuns(Told):
    """The newest dry runs, newest first."""

    items: list[DryRun]


class Health(Told):
    """`ready` means that orders can be taken or worked on."""

    status: Literal["live", "ready", "not_ready"]
    reason: str
