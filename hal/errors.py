"""Every error that the cell can meet, as one tree.

::

    CellError                 code, device, retryable
    ├── ConfigError           a cell, recipe, calibration or fault file is wrong; names place, reason, limit, unit
    ├── DeviceError           something about one device
    │   ├── NotConnected      the link to the device is down
    │   ├── DeviceTimeout     no answer within the deadline; nothing is known of the command
    │   ├── DeviceRefused     the device (or its limits) refused; nothing moved, nothing acted
    │   ├── DeviceFault       the device reports a fault of its own
    │   ├── Interrupted       the command was ended by a halt before it was done
    │   ├── ImplausibleReading  a value that cannot be true: NaN, stuck, stale, out of range
    │   └── UnknownOutcome    the command may or may not have acted; it must never be repeated unasked
    ├── WorkerError           a worker process died or was late; the job has no effects and may be given again
    └── SafetyError           a safety-relevant condition; latched until re-armed
        ├── GuardTripped      the force guard latched
        └── SafetyOpen        e-stop, guard door, STO or bench lock is open or unknown

``retryable`` says whether the same call may be made again without harm. ``code`` is stable: it is the name
that journal, API and documents use.
"""

from __future__ import annotations

from typing import ClassVar


class CellError(Exception):
    """Base of all errors of the cell.

    Attributes:
        code: stable name for journal, API and documents.
        device: name of the device in the cell file, or "" where no single device is meant.
        retryable: whether the same call may be repeated without harm.
    """

    code: ClassVar[str] = "cell_error"
    retryable: ClassVar[bool] = False

    def __init__(self, reason: str, *, device: str = "") -> None:
        super().__init__(f"{device}: {reason}" if device else reason)
        self.reason = reason
        self.device = device


class ConfigError(CellError):
    """A file of the user is wrong. `place` is a dotted path into the file, `limit` and `unit` say what is allowed."""

    code = "config_invalid"

    def __init__(self, reason: str, *, place: str, limit: str = "", unit: str = "") -> None:
        text = f"{place}: {reason}"
        if limit:
            text += f" (limit {limit}{' ' + unit if unit else ''})"
        super().__init__(text)
        self.place = place
        self.limit = limit
        self.unit = unit


class DeviceError(CellError):
    """Something about one device."""

    code = "device_error"


class NotConnected(DeviceError):
    """The link to the device is down."""

    code = "device_not_connected"
    retryable = True


class DeviceTimeout(DeviceError):
    """No answer within the deadline; nothing is known of the command."""

    code = "device_timeout"


class DeviceRefused(DeviceError):
    """The device or its limits refused the command; nothing acted."""

    code = "device_refused"
    retryable = True


class DeviceFault(DeviceError):
    """The device reports a fault of its own."""

    code = "device_fault"


class Interrupted(DeviceError):
    """The command was ended by a halt before it was done."""

    code = "device_interrupted"


class ImplausibleReading(DeviceError):
    """A value that cannot be true: NaN, stuck, stale or out of range."""

    code = "reading_implausible"


class UnknownOutcome(DeviceError):
    """The command may or may not have acted; it must never be repeated unasked."""

    code = "outcome_unknown"


class WorkerError(CellError):
    """A worker process died or was late; the job has no effects and may be given again."""

    code = "worker_failed"
    retryable = True


class SafetyError(CellError):
    """A safety-relevant condition; latched until re-armed."""

    code = "safety"


class GuardTripped(SafetyError):
    """The force guard latched. `force_n` is the force that tripped it, in newton (NaN where it was not force)."""

    code = "guard_tripped"

    def __init__(self, reason: str, *, force_n: float = float("nan"), device: str = "jack_force") -> None:
        super().__init__(reason, device=device)
        self.force_n = force_n


class SafetyOpen(SafetyError):
    """E-stop, guard door, STO or bench lock is open or unknown."""

    code = "safety_open"
