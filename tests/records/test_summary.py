import asyncio

from cellctl.records.chain import GENESIS, Row, link
from cellctl.records.summary import PhaseSummary, RunEnded, as_plain, from_plain, summarise
from hal.clock import run_virtual
from tests.records.world import Insertion, desk, header, small_run


def whole_run() -> tuple[Row, ...]:
    async def main() -> tuple[Row, ...]:
        at = await desk()
        await at.ledger.note("run", header())
        await small_run(at.ledger)
        await at.ledger.note("ended", RunEnded("Complete", "accepted"))
        rows = await at.journal.rows()
        await at.close()
        return rows

    return run_virtual(main())


def test_a_whole_run_in_short() -> None:
    rows = whole_run()
    run = summarise(rows)
    assert (run.run_id, run.recipe, run.recipe_version, run.seed) == ("run-1", "lpt_shaft_36", 1, 7)
    assert (run.state, run.verdict, run.reasons) == ("Complete", "accepted", ())
    assert (run.rows, run.journal_hash) == (len(rows), rows[-1].hash)
    assert [phase.state for phase in run.phases] == ["Complete"] * 5
    assert [phase.cell_time_s for phase in run.phases] == [3.0, 0.0, 0.0, 0.0, 4.0]
    assert run.cell_time_s == 7.0
    assert run.alignment is not None
    assert run.alignment["theta_deg"] == 0.01
    assert run.insertion == {
        "inserted": True, "peak_total_n": 3.5, "peak_bolt_n": None, "force_basis": "bounded_by_total"
    }  # fmt: skip
    assert run.heat == {"reached_c": 66.0, "spread_k": 1.0, "seated": True}
    assert [joint["index"] for joint in run.joints] == [0, 18]
    assert from_plain(as_plain(run)) == run


def test_a_run_that_is_held_on_the_way() -> None:
    async def main() -> tuple[Row, ...]:
        at = await desk()
        await at.ledger.note("run", header())
        await asyncio.sleep(5.0)
        await at.ledger.note("phase_jack_up", Insertion(True, 1.0, None, "per_bolt"))
        rows = await at.journal.rows()
        await at.ledger.note("ended", RunEnded("Held", "held", ("force_limit: it touches",)))
        rows += await at.journal.rows(after=len(rows))
        await at.close()
        return rows

    rows = run_virtual(main())
    ended, running = summarise(rows), summarise(rows[:-1])
    assert (ended.state, ended.verdict, ended.reasons) == ("Held", "held", ("force_limit: it touches",))
    assert (running.state, running.verdict, running.ended_utc) == ("Running", None, None)
    assert running.phases[0] == PhaseSummary("scan", "Running", 5.0)
    assert ended.phases[0].state == "Held"
    assert ended.phases[4].state == "Idle"


def test_what_is_no_finite_number_is_none() -> None:
    async def main() -> tuple[Row, ...]:
        at = await desk()
        joint = {"index": 3, "gun": "a", "stage": "snug", "torque_nm": float("nan"), "angle_deg": float("inf")}
        await at.ledger.note("joint", joint | {"verdict": "unknown"})
        rows = await at.journal.rows()
        await at.close()
        return rows

    (joint,) = summarise(run_virtual(main())).joints
    assert (joint["torque_nm"], joint["angle_deg"], joint["verdict"]) == (None, None, "unknown")


def test_nothing_written_is_nothing_known() -> None:
    run = summarise(())
    assert (run.state, run.verdict, run.journal_hash, run.rows) == ("Running", None, GENESIS, 0)


def test_a_run_that_another_process_ended_has_no_negative_time() -> None:
    times_s = {"run": 100.0, "phase_scan": 130.0, "act": 11_600.0, "verdict": 3.5, "ended": 5.0}
    payloads = {"phase_scan": '{"$type":"Scans"}', "ended": '{"state":"Aborted","verdict":"held"}'}
    rows: list[Row] = []
    for seq, (kind, time_s) in enumerate(times_s.items(), start=1):
        prev = rows[-1].hash if rows else GENESIS
        rows.append(link(seq, time_s, "2026-01-01T00:00:00.000000Z", kind, payloads.get(kind, "{}"), prev))
    run = summarise(tuple(rows))
    assert run.phases[:2] == (PhaseSummary("scan", "Complete", 30.0), PhaseSummary("align", "Aborted", 11_471.5))
    assert run.cell_time_s == 11_501.5
    assert all(phase.cell_time_s == 0.0 for phase in run.phases[2:])
