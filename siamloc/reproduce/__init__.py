"""Published tables and figures, measured again: one call, or one command, for each.

result = siamloc.reproduce.reproduce("figure_3_11", data="freiburg_sim", scale="short")
print(result.table())
result.save("reproduced")
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from siamloc.lazy import lazy

if TYPE_CHECKING:
    from siamloc.reproduce.claims import holds
    from siamloc.reproduce.recipe_book import Recipe, recipe, recipes
    from siamloc.reproduce.running import Reproduction, reproduce

_HOMES = {
    "Recipe": "recipe_book",
    "Reproduction": "running",
    "holds": "claims",
    "recipe": "recipe_book",
    "recipes": "recipe_book",
    "reproduce": "running",
}

__all__ = ["Recipe", "Reproduction", "holds", "recipe", "recipes", "reproduce"]

__getattr__, __dir__ = lazy(__name__, _HOMES)
