"""For the documentation only: `[face] [K]` in docstrings is a shape and a unit, and no link of Markdown."""

import re
from typing import Any

import griffe


class ShapesAreNoLinks(griffe.Extension):
    """Put a space without width between two brackets, so that Markdown does not join them."""

    def on_object(self, *, obj: griffe.Object, **rest: Any) -> None:
        """Change the docstring of a module, class or function."""
        if obj.docstring:
            obj.docstring.value = re.sub(r"\](?=\s+\[)", "]\u200b", obj.docstring.value)
