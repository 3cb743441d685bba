"""Write docs/gallery.md: the figures of all studies, each with its question and the command that makes it.

python -m studies.gallery
"""

import ast
import re
from pathlib import Path

from studies._study import FIGURES, HERE

PAGE = HERE.parent / "docs" / "gallery.md"
HEAD = """# Gallery

Every figure of the studies, with its question and the command that makes it. README's table has the answers.
"""


def maker(figure: str) -> Path:
    """The study that makes a figure: that of its name, or that of the longest name that begins it or names it.

    Raises:
        ValueError: there is none.
    """
    texts = {path: path.read_text(encoding="utf-8") for path in HERE.glob("*.py")}
    studies = {path.stem: path for path, text in texts.items() if re.search(r"^    study\(main", text, re.MULTILINE)}
    begin = [name for name in studies if figure == name or figure.startswith(f"{name}_")]
    named = [name for name, path in studies.items() if f'"{figure}"' in texts[path]]
    if not begin and not named:
        raise ValueError(f"{figure}.png: got no study of that name, expected one that makes it")
    return studies[max(begin or named, key=len)]


def gallery() -> str:
    """The page."""
    parts = [HEAD]
    for path in sorted(FIGURES.glob("*.png"), key=lambda path: (path.stem != "stealth_aircraft", path.stem)):
        study = maker(path.stem)
        text = study.read_text(encoding="utf-8")
        question = (ast.get_docstring(ast.parse(text)) or "").split("\n")[0]
        published = re.search(r'study\(main.*published="([^"]*)"', text)
        command = f"python -m studies.{study.stem}{f' {published[1]}' if published else ''}"
        parts.append(f"**{question}** `{command}`\n\n![{path.stem}](../studies/figures/{path.name})\n")
    return "\n".join(parts)


if __name__ == "__main__":
    PAGE.write_text(gallery(), encoding="utf-8")
    print(f"wrote {PAGE}")
