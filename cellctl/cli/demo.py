"""`cellctl demo`: the service on fakes and one order over HTTP. Exit 0 accepted, 3 rejected or held, 2 not begun."""

from __future__ import annotations

import argparse
import asyncio
import json
import secrets
import sys
import time
from pathlib import Path
from typing import Any

from cellctl.api.problems import Violation
from cellctl.api.schemas import JobOrderRequest, Run, Serials
from cellctl.app import Service
from cellctl.cli.serve import ROOT, add_service_options, run_service, settings_of
from cellctl.client import CellClient, ClientError
from hal.errors import ConfigError

WAYS_TO_IDLE = {"Aborted": "clear", "Stopped": "reset", "Complete": "reset", "Held": "stop"}


def add_parser(subparsers: Any) -> None:
    """Add `demo` to the commands."""
    parser = subparsers.add_parser("demo", help="serve on fake devices and run one whole assembly")
    add_service_options(parser)
    parser.add_argument("--once", action="store_true", help="end after the assembly instead of serving on")
    parser.add_argument("--speed", type=float, default=60.0, help="cell seconds per second (default 60)")
    parser.add_argument("--cell", type=Path, default=ROOT / "deploy" / "cell.fake.toml", help="cell file (TOML)")
    parser.add_argument("--recipe", default="lpt_shaft_36", help="recipe to order (default lpt_shaft_36)")
    parser.add_argument("--recipe-version", type=int, default=1, help="its version (default 1)")
    parser.add_argument("--order", help="id of the job order, which names the parts too (default: a new one)")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Serve, order, tell, and go on serving unless `--once`."""
    verdicts: list[str | None] = []

    async def journey(service: Service) -> None:
        if not service.token:
            raise ConfigError('the demo needs the sign-in mode = "demo"', place="auth.mode")
        say = _Say(args.json)
        say.line(f"page   {service.url}/#token={service.token}")
        say.line(f"token  {service.token} (also in {service.data / 'demo-token'})")
        async with CellClient(service.url, service.token, timeout_s=None) as cell:
            name = args.order or f"demo-{secrets.token_hex(4)}"
            ended = await assembly(cell, name, (args.recipe, args.recipe_version), say)
        record = service.data / "runs" / ended.run_id / "record.zip"
        verdicts.append(ended.verdict)
        say.result(ended, record)
        if not args.once:
            say.line("serving on; Ctrl-C ends")
            await asyncio.Event().wait()

    try:
        code = run_service(settings_of(args, args.cell, args.speed), journey)
    except ClientError as error:
        print(f"cellctl: {error}", *map(_spoken, error.problem.violations), sep="\n", file=sys.stderr)
        return 2
    if code or not verdicts:
        return code or 2
    return 0 if verdicts[0] == "accepted" else 3


def _spoken(one: Violation) -> str:
    limit = f" (limit {one.limit}{' ' + one.unit if one.unit else ''})" if one.limit else ""
    return f"  - {one.pointer}: {one.reason}{limit}"


async def assembly(cell: CellClient, name: str, of: tuple[str, int], say: _Say) -> Run:
    """Bring the cell to Idle, post one order, follow it to its end. Raises ClientError where it is refused."""
    while (now := await cell.cell()).state != "Idle":
        if command := WAYS_TO_IDLE.get(now.state):
            await cell.command(command, "the demo begins")
        cleared = now.state == "Aborted"
        now = await cell.until("Idle", *WAYS_TO_IDLE)
        stuck = now.state == "Stopped" or (cleared and now.state == "Aborted")
        if stuck and now.why and "demo" not in now.why:
            say.line(f"not ready: {now.why}")
            await asyncio.sleep(60.0)
    recipe, version = of
    serials = Serials(rotor=f"R-{name}", shaft=f"S-{name}")
    start = now.event_sequence
    asked = JobOrderRequest(job_order_id=name, recipe=recipe, recipe_version=version, serials=serials)
    order = await cell.post_job_order(asked, key=name)
    say.line(f"order  {name}: run {order.run_id}, recipe {recipe} version {version}")
    async for event in cell.events(start):
        say.event(event)
        if event["kind"] == "run_ended" and event["data"]["run_id"] == order.run_id:
            break
    return await cell.run(order.run_id)


class _Say:
    """What the terminal shows; with `--json` on standard error, so that standard output holds one document."""

    def __init__(self, as_json: bool) -> None:
        self._as_json = as_json
        self._began = time.monotonic()
        self._phase = ""

    def line(self, text: str) -> None:
        """One line."""
        print(text, file=sys.stderr if self._as_json else sys.stdout, flush=True)

    def event(self, event: dict[str, Any]) -> None:
        """An event, where it is worth a line."""
        data = event["data"]
        elapsed = time.monotonic() - self._began
        if event["kind"] == "progress":
            self.line(f"{elapsed:6.1f} s  {data['phase']:8} {100 * data['fraction']:3.0f} %  {data['text']}")
        elif event["kind"] == "state":
            said = data["why"] or ("dry run on a private twin" if data["state"] == "Starting" else "")
            self.line(f"{elapsed:6.1f} s  {data['state']}{': ' + said if said else ''}")
        elif event["kind"] == "alarm":
            self.line(f"{elapsed:6.1f} s  alarm: {data['text']}")

    def result(self, run: Run, record: Path) -> None:
        """The verdict, and where the record lies."""
        wall_s = time.monotonic() - self._began
        if self._as_json:
            place = str(record) if run.sealed else None
            told = {"verdict": run.verdict, "reasons": run.reasons, "run_id": run.run_id, "record": place}
            print(json.dumps(told | {"journal_hash": run.journal_hash, "wall_time_s": wall_s}), flush=True)
            return
        self.line(f"\nverdict  {run.verdict}")
        for reason in run.reasons:
            self.line(f"  - {reason}")
        self.line(f"record   {record if run.sealed else 'none'}\nwall     {wall_s:.0f} s")
