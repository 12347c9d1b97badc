"""The fault book as a fake sees it that stands behind a simulator: the wire's own faults are acted out on the wire."""

from __future__ import annotations

from hal.fake.faults import EXCHANGE_DEADLINE_S, FaultBook


class BehindWire(FaultBook):
    """Shares everything with `book` but its gate, which is always open."""

    def __init__(self, book: FaultBook) -> None:
        self.__dict__ = book.__dict__

    async def gate(self, device: str, command: str, *, deadline_s: float = EXCHANGE_DEADLINE_S) -> None:
        """Pass: whether the link is gone, hung or late was decided before."""
