"""What a check says."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Finding:
    """What speaks against a recipe: `name` of the check, `place` in the recipe, one sentence, limit and unit."""

    name: str
    place: str
    reason: str
    limit: str = ""
    unit: str = ""

    def __str__(self) -> str:
        limit = f" (limit {self.limit}{' ' + self.unit if self.unit else ''})" if self.limit else ""
        return f"{self.place}: {self.reason}{limit} [{self.name}]"
