"""Register maps of the cell's Modbus devices, one frozen `Block` per group that is read or written in one go.

Registers count from the device's base. Identity lies where the unit has it, whatever devices stand behind the unit.
"""

from __future__ import annotations

from hal.codec.registers import Bits, Block, Float, Scaled, Text

SIMULATOR = "cellctl"
"""What a simulator calls its vendor."""

VENDOR, MODEL = Text("vendor", 0x1000, 8), Text("model", 0x1008, 12)
SERIAL, FIRMWARE = Text("serial", 0x1014, 8), Text("firmware", 0x101C, 4)
IDENTITY = Block((VENDOR, MODEL, SERIAL, FIRMWARE))

# Thermocouple module: one group per channel. The counter grows with each conversion.
OPEN_CIRCUIT, OUT_OF_RANGE = "open_circuit", "out_of_range"
TC_VALUE = Float("temperature_c", 0)
TC_STATUS = Bits("status", 2, (OPEN_CIRCUIT, OUT_OF_RANGE))
TC_COUNTER = Scaled("conversions", 3)
THERMOCOUPLE = Block((TC_VALUE, TC_STATUS, TC_COUNTER))

# Pyrometer: as the above with the low word first, and its set emissivity.
PYRO_VALUE = Float("temperature_c", 0, order="low_first")
PYRO_STATUS = Bits("status", 2, (OPEN_CIRCUIT, OUT_OF_RANGE))
PYRO_COUNTER = Scaled("conversions", 3)
PYRO_EMISSIVITY = Scaled("emissivity", 4, per_unit=1000, low=0.05, high=1.1)
PYROMETER = Block((PYRO_VALUE, PYRO_STATUS, PYRO_COUNTER, PYRO_EMISSIVITY))

# Gap probe: steps of 0.1 um.
GAP_VALUE = Scaled("gap_mm", 0, per_unit=10_000, signed=True)
GAP_STATUS = Bits("status", 1, (OPEN_CIRCUIT, OUT_OF_RANGE))
GAP_COUNTER = Scaled("conversions", 2)
GAP_PROBE = Block((GAP_VALUE, GAP_STATUS, GAP_COUNTER))

# Heater controller. Orders take effect when `run` is written; the controller keeps them in EEPROM.
HEATER_SETPOINT = Float("working_setpoint_c", 0)
HEATER_POWER = Float("power_w", 2)
HEATER_STATUS = Bits("status", 4, ("on", "watchdog_armed", "supply"))
HEATER_ALARM = Scaled("alarm", 5)
HEATER_STATE = Block((HEATER_SETPOINT, HEATER_POWER, HEATER_STATUS, HEATER_ALARM))
ORDER_SETPOINT = Float("setpoint_c", 16)
ORDER_RAMP = Float("ramp_k_per_min", 18)
ORDER_LIMIT = Float("power_limit_w", 20)
HEATER_ORDER = Block((ORDER_SETPOINT, ORDER_RAMP, ORDER_LIMIT))
HEATER_RUN_WORD = Scaled("run", 22, high=1)
HEATER_RUN = Block((HEATER_RUN_WORD,))
HEATER_WATCHDOG_S = Scaled("watchdog_s", 23, per_unit=1000)
HEATER_WATCHDOG = Block((HEATER_WATCHDOG_S,))
HEATER_RESET_WORD = Scaled("reset", 24)
HEATER_RESET = Block((HEATER_RESET_WORD,))
HEATER_SIZE = 25
HEATER_ALARMS = ("", "watchdog", "over-temperature", "safety circuit open", "sensor break", "loop break", "other")
"""Texts of the alarm numbers."""

# Remote I/O: outputs, their watchdog (seconds, 0 = off), then inputs. `supply` says whether the outputs have power;
# `dropped` that the coupler has cleared them for silence, until they are written again.
IO_WATCHDOG_S = Scaled("watchdog_s", 1, per_unit=1000)
IO_WATCHDOG = Block((IO_WATCHDOG_S,))
COUPLER_BITS = ("supply", "dropped")

CHUCK_OUT = Bits("outputs", 0, ("clamp", "release"))
CHUCK_IN = Bits("inputs", 2, (*COUPLER_BITS, "clamped_1", "clamped_2", "open"))
CHUCK_PRESSURE = Scaled("pressure_bar", 3, per_unit=100)
CHUCK = Block((CHUCK_OUT, IO_WATCHDOG_S, CHUCK_IN, CHUCK_PRESSURE))

PARK_PLACES = ("parked", "rotor", "shaft")
PARK_OUT = Bits("outputs", 0, PARK_PLACES)
PARK_IN = Bits("inputs", 2, (*COUPLER_BITS, *PARK_PLACES))
PARK = Block((PARK_OUT, IO_WATCHDOG_S, PARK_IN))

FEEDER_OUT = Bits("outputs", 0, ("slide_a", "slide_b"))
FEEDER_IN = Bits("inputs", 2, (*COUPLER_BITS, "guns_back", "out_a", "out_b", "nut_a", "nut_b"))
FEEDER_COUNT = Scaled("nuts", 3)
FEEDER = Block((FEEDER_OUT, IO_WATCHDOG_S, FEEDER_IN, FEEDER_COUNT))

ENABLE_OUT = Bits("outputs", 0, ("tools",))
ENABLE_IN = Bits("inputs", 2, COUPLER_BITS)
ENABLE = Block((ENABLE_OUT, IO_WATCHDOG_S, ENABLE_IN))

# Mirror of the safety circuit: two channels each; the counter of the safety controller grows ten times a second.
SAFETY_PAIRS = ("estop", "guards", "sto")
SAFETY_IN = Bits(
    "inputs", 0, (*(f"{pair}_{channel}" for pair in SAFETY_PAIRS for channel in (1, 2)), "bench_locked", "bench_moved")
)
SAFETY_COUNTER = Scaled("life", 1)
SAFETY_MIRROR = Block((SAFETY_IN, SAFETY_COUNTER))
SAFETY_RESET_WORD = Scaled("bench_reset", 2)
SAFETY_RESET = Block((SAFETY_RESET_WORD,))
SAFETY_SIZE = 3

# Part station: an order (serial numbers, then a job number) and the answer to that job.
WANTED_ROTOR, WANTED_SHAFT = Text("wanted_rotor", 0, 16), Text("wanted_shaft", 16, 16)
STATION_WANTED = Block((WANTED_ROTOR, WANTED_SHAFT))
STATION_JOB_WORD = Scaled("job", 32)
STATION_JOB = Block((STATION_JOB_WORD,))
ANSWERED_JOB, STATION_RESULT = Scaled("answered_job", 33), Scaled("result", 34)
READ_ROTOR, READ_SHAFT = Text("read_rotor", 35, 16), Text("read_shaft", 51, 16)
STATION_ANSWER = Block((ANSWERED_JOB, STATION_RESULT, READ_ROTOR, READ_SHAFT))
STATION_SIZE = 67
STATION_BUSY, STATION_DONE, STATION_JACK_UP, STATION_UNREADABLE, STATION_FAILED, STATION_IDLE = 1, 2, 3, 4, 5, 0
