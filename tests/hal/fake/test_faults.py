"""The fault book and its files."""

from __future__ import annotations

import asyncio
import math

import numpy as np
import pytest

from hal.clock import run_virtual
from hal.entries import Devices
from hal.errors import ConfigError, DeviceTimeout, NotConnected
from hal.fake.fault_kinds import DEVICE_KINDS
from hal.fake.faults import Fault, FaultBook, parse_faults, wrong_places
from hal.interfaces import Quality

GOOD = """
[[fault]]
device = "heater"
phase = "heat"
at_s = 60
kind = "loop_break"
duration_s = 5.0

[[fault]]
device = "spigot_tc_1"
kind = "drift"
value = 0.1

[expect]
state = "Held"
verdict = "held"
reason = "loop"
"""


def test_every_device_of_the_cell_has_faults_of_its_own() -> None:
    assert set(DEVICE_KINDS) == set(Devices.model_fields)
    assert all(len(kinds) >= 5 for kinds in DEVICE_KINDS.values())
    assert sum(len(kinds) for kinds in DEVICE_KINDS.values()) >= 25


def test_a_file_is_read_whole() -> None:
    book = parse_faults(GOOD)
    assert book.faults == (
        Fault("heater", "loop_break", phase="heat", at_s=60.0, duration_s=5.0),
        Fault("spigot_tc_1", "drift", value=0.1),
    )
    assert book.expect is not None
    assert (book.expect.state, book.expect.verdict, book.expect.reason) == ("Held", "held", "loop")


@pytest.mark.parametrize(
    ("old", "new", "place", "reason"),
    [
        ('device = "heater"', 'device = "oven"', "f.fault.0.device", "unknown device 'oven'"),
        ('kind = "loop_break"', 'kind = "nan"', "f.fault.0.kind", "heater has no fault of kind 'nan'"),
        ('phase = "heat"', 'phase = "cook"', "f.fault.0.phase", "unknown phase 'cook'"),
        ("at_s = 60", "at_s = -1", "f.fault.0.at_s", "got -1"),
        ("at_s = 60", "at_s = true", "f.fault.0.at_s", "got True"),
        ("duration_s = 5.0", "duration_s = nan", "f.fault.0.duration_s", "got nan"),
        ("duration_s = 5.0", "value = 5.0", "f.fault.0.value", "takes no value"),
        ("duration_s = 5.0", "until_s = 5.0", "f.fault.0", "unknown key 'until_s'"),
        ("value = 0.1", "", "f.fault.1.value", "a value is needed"),
        ("value = 0.1", "value = inf", "f.fault.1.value", "got inf"),
        ('state = "Held"', 'state = "Broken"', "f.expect.state", "got 'Broken'"),
        ('verdict = "held"', "", "f.expect.verdict", "got None"),
        ("[expect]", "[expected]", "f", "unknown key 'expected'"),
        ("[[fault]]", "[[fault", "f", "not TOML"),
    ],
)
def test_whatever_is_wrong_is_named_with_its_place(old: str, new: str, place: str, reason: str) -> None:
    wrong = wrong_places(GOOD.replace(old, new, 1), source="f")
    assert [error.place for error in wrong] == [place]
    assert reason in str(wrong[0])
    with pytest.raises(ConfigError, match="f"):
        parse_faults(GOOD.replace(old, new, 1), source="f")


def test_several_wrong_places_are_all_named_at_once() -> None:
    text = GOOD.replace('"heater"', '"oven"').replace("value = 0.1", "")
    with pytest.raises(ConfigError) as caught:
        parse_faults(text, source="f")
    assert "f.fault.0.device" in str(caught.value)
    assert "f.fault.1.value" in str(caught.value)


def test_a_joint_number_must_be_whole() -> None:
    text = '[[fault]]\ndevice = "gun_a"\nkind = "cross_thread"\nvalue = 1.5\n'
    assert [error.place for error in wrong_places(text)] == ["faults.fault.0.value"]


def test_a_fault_waits_for_its_phase_and_ends_after_its_duration() -> None:
    book = FaultBook([Fault("heater", "loop_break", phase="heat", at_s=60.0, duration_s=5.0)])
    assert book.active("heater", "loop_break", 1e6) is None
    assert book.next_change("heater", 0.0) == math.inf
    book.enter_phase("heat", 100.0)
    book.enter_phase("heat", 500.0)
    assert book.next_change("heater", 100.0) == 160.0
    assert [book.active("heater", "loop_break", now) is not None for now in (159.9, 160.0, 164.9, 165.0)] == [
        False,
        True,
        True,
        False,
    ]
    assert book.next_change("heater", 160.0) == 165.0
    assert book.active("heater", "stuck_on", 161.0) is None
    assert book.active("chuck", "opening", 161.0) is None


def test_a_taken_fault_strikes_once_and_equal_rows_strike_twice() -> None:
    book = FaultBook([Fault("nut_feeder", "missing_nut"), Fault("nut_feeder", "missing_nut")])
    assert [book.take("nut_feeder", "missing_nut", 0.0) is not None for _ in range(3)] == [True, True, False]


def test_the_gate_fails_as_the_device_would() -> None:
    book = FaultBook(
        [
            Fault("chuck", "gone", duration_s=1.0),
            Fault("heater", "hung"),
            Fault("jack", "hung", duration_s=0.5),
            Fault("safety", "late", value=0.3),
            Fault("gun_a", "late", value=9.0),
        ]
    )

    async def main() -> None:
        loop = asyncio.get_running_loop()
        with pytest.raises(NotConnected, match="chuck: no link"):
            await book.gate("chuck", "read")
        await book.gate("jack", "halt")
        assert loop.time() == pytest.approx(0.5)
        await book.gate("safety", "read")
        assert loop.time() == pytest.approx(0.8)
        for device in ("heater", "gun_a"):
            before = loop.time()
            with pytest.raises(DeviceTimeout, match=r"within 1\.5 s"):
                await book.gate(device, "read", deadline_s=1.5)
            assert loop.time() - before == pytest.approx(1.5)
        await book.gate("chuck", "read")
        await book.gate("stage_x", "read")

    run_virtual(main())


def test_a_hung_exchange_can_be_cancelled() -> None:
    book = FaultBook([Fault("heater", "hung")])

    async def main() -> float:
        with pytest.raises(TimeoutError):
            async with asyncio.timeout(0.1):
                await book.gate("heater", "off")
        return asyncio.get_running_loop().time()

    assert run_virtual(main()) == pytest.approx(0.1)


def test_readings_go_wrong_as_their_kind_says() -> None:
    def read(kind: str, value: float | None = None) -> tuple[float, float, Quality]:
        book = FaultBook([Fault("rotor_tc", kind, at_s=10.0, value=value)])
        book.reading("rotor_tc", 20.0, 9.0)
        reading = book.reading("rotor_tc", 30.0, 12.0)
        return reading.value, reading.time_s, reading.quality

    assert math.isnan(read("nan")[0])
    assert read("nan")[2] is Quality.BAD
    assert read("stuck") == (20.0, 12.0, Quality.GOOD)
    assert read("stuck", 55.0) == (55.0, 12.0, Quality.GOOD)
    assert read("drift", 0.5) == (31.0, 12.0, Quality.GOOD)
    assert read("out_of_range", 1370.0) == (1370.0, 12.0, Quality.BAD)
    assert read("stale") == (20.0, 9.0, Quality.GOOD)
    assert FaultBook().reading("rotor_tc", 30.0, 12.0).value == 30.0


def test_streams_go_wrong_from_the_very_sample_on() -> None:
    times = np.arange(5) * 0.001
    values = np.arange(5.0)

    def read(kind: str, value: float | None = None, duration_s: float = math.inf) -> list[float]:
        book = FaultBook([Fault("jack_force", kind, at_s=0.002, value=value, duration_s=duration_s)])
        return book.samples("jack_force", values, times).tolist()

    assert np.isnan(read("nan")).tolist() == [False, False, True, True, True]
    assert read("stuck") == [0.0, 1.0, 1.0, 1.0, 1.0]
    assert read("stuck", 7.0, duration_s=0.0015) == [0.0, 1.0, 7.0, 7.0, 4.0]
    assert read("out_of_range", 2000.0) == [0.0, 1.0, 2000.0, 2000.0, 2000.0]
    assert read("drift", 1000.0) == pytest.approx([0.0, 1.0, 2.0, 4.0, 6.0])
    assert values.tolist() == [0.0, 1.0, 2.0, 3.0, 4.0]


@pytest.mark.parametrize("kind", ["stuck", "stale"])
def test_a_sensor_that_fails_before_its_first_reading_keeps_that_reading(kind: str) -> None:
    book = FaultBook([Fault("rotor_tc", kind, at_s=5.0)])
    first, later = book.reading("rotor_tc", 20.0, 6.0), book.reading("rotor_tc", 25.0, 30.0)
    assert first.value == later.value == 20.0
    assert later.time_s == (5.0 if kind == "stale" else 30.0)


def test_a_stuck_stream_stays_stuck_over_blocks() -> None:
    book = FaultBook([Fault("jack_force", "stuck", at_s=0.002)])
    book.samples("jack_force", np.array([1.0, 2.0, 3.0]), np.array([0.0, 0.001, 0.002]))
    assert book.samples("jack_force", np.array([4.0, 5.0]), np.array([0.003, 0.004])).tolist() == [2.0, 2.0]


def test_a_hard_wired_stop_cuts_the_power_while_it_lasts() -> None:
    book = FaultBook([Fault("safety", "estop", at_s=1.0, duration_s=2.0), Fault("safety", "bench_moved")])
    assert [book.power_cut(now) for now in (0.5, 1.5, 3.5)] == ["", "estop", ""]


def test_what_happens_in_metal_happens_when_the_fault_begins() -> None:
    book = FaultBook([Fault("chuck", "opening", phase="jack_up", at_s=2.0), Fault("chuck", "opening", at_s=1.0)])

    async def main() -> list[float]:
        loop = asyncio.get_running_loop()
        seen: list[float] = []
        end = book.when("chuck", "opening", lambda: seen.append(loop.time()))
        other = book.when("chuck", "opening", lambda: seen.append(-1.0))
        other()
        await asyncio.sleep(5.0)
        book.enter_phase("jack_up", loop.time())
        await asyncio.sleep(5.0)
        end()
        return seen

    assert run_virtual(main()) == pytest.approx([1.0, 7.0])
