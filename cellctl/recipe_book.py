"""The recipes that may be ordered: every TOML file of one folder."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from cellctl.recipe import Recipe, load_recipe
from hal.errors import ConfigError


@dataclass(frozen=True, slots=True)
class RecipeBook:
    """Recipes by id and version; read once, so that a file that changes later changes no order."""

    recipes: Mapping[tuple[str, int], Recipe]

    def get(self, name: str, version: int) -> Recipe | None:
        """The recipe of that id and version."""
        return self.recipes.get((name, version))

    def versions(self, name: str) -> list[int]:
        """The versions that there are of a recipe."""
        return sorted(version for known, version in self.recipes if known == name)

    def all(self) -> list[Recipe]:
        """Every recipe, by id and version."""
        return [self.recipes[key] for key in sorted(self.recipes)]


def load_book(folder: Path) -> RecipeBook:
    """Read every recipe of `folder`, not of the folders below it. Raises ConfigError."""
    recipes: dict[tuple[str, int], Recipe] = {}
    for path in sorted(folder.glob("*.toml")):
        recipe = load_recipe(path)
        key = (recipe.recipe.id, recipe.recipe.version)
        if key in recipes:
            raise ConfigError(f"{key[0]} version {key[1]} stands in two files", place=f"{path.name}.recipe.version")
        recipes[key] = recipe
    if not recipes:
        raise ConfigError("no recipe here", place=str(folder))
    return RecipeBook(recipes)
