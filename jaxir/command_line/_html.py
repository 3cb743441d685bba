"""One HTML file that holds everything it shows."""

from __future__ import annotations

import base64
import html
import io
from collections.abc import Sequence
from typing import Any

STYLE = """
body { font: 15px/1.45 system-ui, sans-serif; max-width: 1100px; margin: 2em auto; padding: 0 1em; color: #222; }
h1 { font-size: 1.6em; } h2 { font-size: 1.25em; margin-top: 2em; border-bottom: 1px solid #ccc; }
h3 { font-size: 1.05em; }
img { max-width: 100%; } figure { margin: 1em 0; } figcaption { color: #555; font-size: .9em; }
pre { background: #f5f5f5; padding: .7em; overflow-x: auto; font-size: .85em; }
table { border-collapse: collapse; margin: 1em 0; font-size: .9em; }
th, td { border: 1px solid #ccc; padding: .25em .6em; text-align: right; }
th:first-child, td:first-child { text-align: left; }
@media print { body { max-width: none; margin: 0; } h2 { break-after: avoid; } figure, tr { break-inside: avoid; } }
"""


class Page:
    """A page that grows downwards; every text is escaped."""

    def __init__(self, title: str):
        self.title = title
        self.parts: list[str] = [f"<h1>{html.escape(title)}</h1>"]

    def heading(self, text: str, level: int = 2) -> None:
        """A heading."""
        self.parts.append(f"<h{level}>{html.escape(text)}</h{level}>")

    def paragraph(self, text: str) -> None:
        """A paragraph."""
        self.parts.append(f"<p>{html.escape(text)}</p>")

    def listed(self, lines: Sequence[str]) -> None:
        """A list."""
        self.parts.append("<ul>" + "".join(f"<li>{html.escape(line)}</li>" for line in lines) + "</ul>")

    def text(self, text: str, folded: str = "") -> None:
        """Text as it is, behind a line to open it where `folded` says what it is."""
        shown = f"<pre>{html.escape(text)}</pre>"
        self.parts.append(f"<details><summary>{html.escape(folded)}</summary>{shown}</details>" if folded else shown)

    def figure(self, figure: Any, caption: str) -> None:
        """A figure of matplotlib as a picture inside the page."""
        held = io.BytesIO()
        figure.savefig(held, dpi=110, format="png")
        picture = base64.b64encode(held.getvalue()).decode()
        said = html.escape(caption)
        self.parts.append(
            f'<figure><img alt="{said}" src="data:image/png;base64,{picture}"><figcaption>{said}</figcaption></figure>'
        )

    def table(self, head: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
        """A table, numbers as they are written."""
        cells = [("th", head), *(("td", row) for row in rows)]
        lines = ("".join(f"<{tag}>{html.escape(cell)}</{tag}>" for cell in row) for tag, row in cells)
        self.parts.append("<table>" + "".join(f"<tr>{line}</tr>" for line in lines) + "</table>")

    def __str__(self) -> str:
        """The whole file."""
        head = f'<meta charset="utf-8"><title>{html.escape(self.title)}</title><style>{STYLE}</style>'
        body = "\n".join(self.parts)
        return f'<!DOCTYPE html>\n<html lang="en"><head>{head}</head>\n<body>\n{body}\n</body></html>\n'
