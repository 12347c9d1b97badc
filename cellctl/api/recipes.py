"""The recipes that may be ordered."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Depends, Header, Response

from cellctl.api.auth import Allow, Role
from cellctl.api.problems import ProblemError
from cellctl.api.schemas import RecipeEntry, Recipes
from cellctl.api.services import Services, services_of
from cellctl.api.strict import StrictRoute
from cellctl.recipe import Recipe

VIEWER = [Depends(Allow(Role.VIEWER))]
router = APIRouter(route_class=StrictRoute, tags=["recipes"])


@router.get("/recipes", dependencies=VIEWER)
async def all_recipes(services: Annotated[Services, Depends(services_of)]) -> Recipes:
    """Every recipe, by id and version."""
    return Recipes(items=[_entry(recipe) for recipe in services.recipes.all()])


@router.get("/recipes/{recipe_id}", dependencies=VIEWER)
async def versions(recipe_id: str, services: Annotated[Services, Depends(services_of)]) -> Recipes:
    """The versions of one recipe."""
    items = [_entry(recipe) for recipe in services.recipes.all() if recipe.recipe.id == recipe_id]
    if not items:
        raise ProblemError(404, "recipe_unknown", "no recipe of that id")
    return Recipes(items=items)


@router.get(
    "/recipes/{recipe_id}/versions/{version}",
    response_model=Recipe,
    responses={304: {"description": "The client has it already"}},
    dependencies=VIEWER,
)
async def one_recipe(
    recipe_id: str,
    version: int,
    response: Response,
    services: Annotated[Services, Depends(services_of)],
    if_none_match: Annotated[str | None, Header()] = None,
) -> Recipe | Response:
    """One version of a recipe, whole. Its ETag is the content hash."""
    recipe = services.recipes.get(recipe_id, version)
    if recipe is None:
        raise ProblemError(404, "recipe_unknown", "no recipe of that id and version")
    etag = f'"{recipe.content_hash}"'
    if if_none_match == etag:
        return Response(status_code=304, headers={"ETag": etag})
    response.headers["ETag"] = etag
    return recipe


def _entry(recipe: Recipe) -> RecipeEntry:
    header = recipe.recipe
    return RecipeEntry(
        id=header.id,
        version=header.version,
        title=header.title,
        bolts=recipe.pattern.count,
        content_hash=recipe.content_hash,
    )
