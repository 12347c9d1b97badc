"""What can go wrong with records; part of the tree of hal.errors, so that callers treat them as any other.

::

    CellError
    └── RecordError
        ├── ScanUnknown          the run has no scan of that kind that was measured
        ├── ScanNotKept          the scan was measured, its cloud was dropped by the policy
        ├── JournalUnavailable   a row or blob could not be made durable (disk full, read-only, closed)
        ├── RecordCorrupt        what is on disk is not what was written
        └── UnknownRun           no run of that id is stored
"""

from __future__ import annotations

from hal.errors import CellError


class RecordError(CellError):
    """Something about the records."""

    code = "record_error"


class JournalUnavailable(RecordError):
    """It could not be made durable: nothing was written, the same append may be made again when there is room."""

    code = "journal_unavailable"
    retryable = True


class RecordCorrupt(RecordError):
    """What is on disk is not what was written; the reason says where."""

    code = "record_corrupt"


class ScanUnknown(RecordError):
    """The run has no scan of that kind that was measured."""

    code = "scan_unknown"


class ScanNotKept(RecordError):
    """The scan was measured, but its cloud is not kept."""

    code = "scan_not_kept"


class UnknownRun(RecordError):
    """No run of that id is stored."""

    code = "run_unknown"
