"""Physics checks of a recipe, a file for each part of the work; `cellctl.recipe_checks.check` runs them all."""
