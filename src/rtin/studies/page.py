"""Reports as web pages: one file with tables and pictures that needs no network."""

from __future__ import annotations

import base64
from collections.abc import Iterable, Sequence
from html import escape

__all__ = ["page", "paragraphs", "picture", "table"]

_STYLE = """
body { margin: 0 auto; max-width: 72rem; padding: 1rem; color: #1c2733; background: #fff;
       font: 16px/1.5 system-ui, sans-serif; }
h1 { font-size: 1.4rem; line-height: 1.25; overflow-wrap: anywhere; }
p, li { overflow-wrap: anywhere; }
.wide { overflow-x: auto; }
table { border-collapse: collapse; font-size: .875rem; font-variant-numeric: tabular-nums; }
th, td { padding: .25rem .6rem; text-align: right; white-space: nowrap;
         border-bottom: 1px solid #dde3e8; }
th { border-bottom-color: #8a939c; }
th:first-child, td:first-child, td.text, th.text { text-align: left; }
tr.first td { border-top: 2px solid #8a939c; font-weight: 600; }
figure { margin: 1.5rem 0; }
img { display: block; max-width: 100%; height: auto; }
figcaption { font-size: .875rem; color: #4a5560; }
"""


def page(title: str, parts: Iterable[str]) -> bytes:
    """Return a page of these parts, as the other functions here make them."""
    heading = escape(title)
    return "\n".join(
        [
            '<!doctype html><html lang="en"><head><meta charset="utf-8">',
            '<meta name="viewport" content="width=device-width, initial-scale=1">',
            f"<title>{heading}</title><style>{_STYLE}</style></head><body>",
            f"<h1>{heading}</h1>",
            *parts,
            "</body></html>\n",
        ]
    ).encode()


def paragraphs(lines: Iterable[str]) -> str:
    """Return a paragraph for each line."""
    return "\n".join(f"<p>{escape(line)}</p>" for line in lines)


def table(head: Sequence[str], rows: Iterable[Sequence[str]], *, firsts: Sequence[int] = ()) -> str:
    """Return a table of text, scrolled sideways where the screen is narrow.

    The rows numbered ``firsts`` begin a part. The first two columns are text, the others numbers.
    """

    def line(cells: Sequence[str], tag: str, kind: str = "") -> str:
        marks = [' class="text"' if number < 2 else "" for number in range(len(cells))]
        inner = "".join(
            f"<{tag}{mark}>{escape(cell)}</{tag}>" for cell, mark in zip(cells, marks, strict=True)
        )
        return f"<tr{kind}>{inner}</tr>"

    body = [
        line(cells, "td", ' class="first"' if number in firsts else "")
        for number, cells in enumerate(rows)
    ]
    return "\n".join(['<div class="wide"><table>', line(head, "th"), *body, "</table></div>"])


def picture(png: bytes, caption: str) -> str:
    """Return a picture with a caption below it."""
    data, text = base64.b64encode(png).decode(), escape(caption)
    return (
        f'<figure><img alt="{text}" src="data:image/png;base64,{data}">'
        f"<figcaption>{text}</figcaption></figure>"
    )
