"""What a drive is told at the start, and what it must agree with, from its entry in the cell file. Pure."""

from __future__ import annotations

import math

from hal.codec import cia402 as drive
from hal.codec.cia301 import (
    CONSUMER_HEARTBEAT,
    ERROR_BEHAVIOUR,
    ERROR_BEHAVIOUR_STAY,
    ON_CHANGE,
    PDO_OFF,
    PRODUCER_HEARTBEAT,
    PRODUCT,
    SERIAL,
    TPDO1,
    TPDO2,
    VENDOR,
    Entry,
    consumer_heartbeat,
    pdo_cob,
    pdo_mapping,
)
from hal.entries import CanAxisEntry


def counts(entry: CanAxisEntry, value: float) -> int:
    """A position, speed or acceleration in the drive's units."""
    return round(value * entry.counts_per_unit)


def expected(entry: CanAxisEntry) -> dict[Entry, int]:
    """What the drive must read: a scale that differs makes every length wrong, an identity another drive."""
    known = {
        drive.ENCODER_INCREMENTS: entry.encoder_increments,
        drive.ENCODER_REVOLUTIONS: entry.encoder_revolutions,
        drive.GEAR_MOTOR: entry.gear_motor,
        drive.GEAR_SHAFT: entry.gear_shaft,
        drive.FEED: entry.feed,
        drive.FEED_SHAFT: entry.feed_shaft,
    }
    identity = {VENDOR: entry.vendor, PRODUCT: entry.product, SERIAL: entry.serial}
    return {one: value for one, value in identity.items() if value is not None} | known


def settings(entry: CanAxisEntry, controller: int) -> dict[Entry, int]:
    """What is set and read back at the start. `controller` is the node whose heartbeat the drive expects."""
    homing = counts(entry, entry.homing_share * entry.max_speed)
    return {
        drive.QUICK_STOP_OPTION: drive.STAY_IN_QUICK_STOP,
        drive.ABORT_CONNECTION: drive.ABORT_QUICK_STOP,
        drive.FAULT_REACTION: drive.FAULT_QUICK_STOP,
        ERROR_BEHAVIOUR: ERROR_BEHAVIOUR_STAY,
        CONSUMER_HEARTBEAT: consumer_heartbeat(controller, round(entry.consumer_s * 1e3)),
        PRODUCER_HEARTBEAT: round(entry.heartbeat_s * 1e3),
        drive.FOLLOWING_WINDOW: counts(entry, entry.following_error),
        drive.LIMIT_LOW: counts(entry, entry.low),
        drive.LIMIT_HIGH: counts(entry, entry.high),
        drive.PROFILE_ACCELERATION: counts(entry, entry.max_acceleration),
        drive.PROFILE_DECELERATION: counts(entry, entry.max_acceleration),
        drive.QUICK_STOP_DECELERATION: counts(entry, entry.quick_stop_factor * entry.max_acceleration),
        drive.MAX_MOTOR_SPEED: motor_rpm(entry),
        drive.HOMING_METHOD: entry.homing_method,
        drive.HOMING_SPEED: homing,
        drive.HOMING_SPEED_ZERO: max(homing // 10, 1),
        drive.HOMING_ACCELERATION: counts(entry, entry.max_acceleration),
    }


def motor_rpm(entry: CanAxisEntry) -> int:
    """Motor speed at the axis' largest speed, revolutions per minute, rounded up."""
    shaft = entry.max_speed * entry.counts_per_unit * entry.feed_shaft / entry.feed
    return math.ceil(60.0 * shaft * entry.gear_motor / entry.gear_shaft)


def pdo_settings(entry: CanAxisEntry) -> list[tuple[Entry, int]]:
    """Writes, in order, that give the drive its four PDOs: switched off, mapped, switched on (CiA 301, 7.5.2.36)."""
    writes: list[tuple[Entry, int]] = []
    for function, layout in drive.LAYOUTS.items():
        cob, value = pdo_cob(function, entry.node)
        mapping = pdo_mapping(function)
        count = Entry(mapping, 0, "B", "mapped objects")
        writes += [(cob, value | PDO_OFF), (count, 0)]
        writes += [
            (Entry(mapping, place, "I", "mapped object"), one.mapping) for place, one in enumerate(layout, start=1)
        ]
        writes += [(count, len(layout)), (Entry(cob.index, 2, "B", "transmission type"), ON_CHANGE)]
        if function in (TPDO1, TPDO2):
            timer = round(entry.pdo_s * 1e3) if function == TPDO2 else 0
            writes.append((Entry(cob.index, 5, "H", "event timer"), timer))
        writes.append((cob, value))
    return writes
