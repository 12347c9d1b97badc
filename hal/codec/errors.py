"""What a codec raises for bytes that are not what they should be."""

from __future__ import annotations


class CodecError(ValueError):
    """`place` says where, `reason` why."""

    def __init__(self, place: str, reason: str) -> None:
        super().__init__(f"{place}: {reason}")
        self.place = place
        self.reason = reason
