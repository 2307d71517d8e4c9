"""A web page of tables and figures. It holds everything that it shows: no request leaves it. Light and dark."""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from importlib.resources import files
from pathlib import Path
from typing import NamedTuple

from eairl_jax.storage import replacing


class Table(NamedTuple):
    """A table of texts; the first column holds the names of the rows.

    Attributes:
      note: a remark below it.
    """

    title: str
    columns: Sequence[str]
    rows: Sequence[Sequence[str]]
    note: str = ""


class Picture(NamedTuple):
    """A figure.

    Attributes:
      url: a data URL (`data_url`).
      is_wide: whether it has panels side by side, which a phone shows in their size, to be scrolled.
    """

    title: str
    url: str
    is_wide: bool = True


class Link(NamedTuple):
    """A link to a file beside the page."""

    text: str
    href: str


class Page(NamedTuple):
    """What a page shows, from above to below. Every text is shown as it is: nothing in it is taken for HTML.

    Attributes:
      facts: how the content was made, by name.
      settings: shown when the reader opens them.
    """

    title: str
    subtitle: str
    tables: Sequence[Table] = ()
    pictures: Sequence[Picture] = ()
    links: Sequence[Link] = ()
    facts: Mapping[str, str] = {}
    settings: Mapping[str, str] = {}


def write(path: Path, page: Page) -> None:
    """Writes a page, atomically."""
    with replacing(path) as unfinished:
        unfinished.write_text(html(page), encoding="utf-8", errors="replace")


def html(page: Page) -> str:
    """The page, as text."""
    from jinja2 import Environment

    template = (files("eairl_jax.experiments.display") / "page.html").read_text(encoding="utf-8")
    environment = Environment(autoescape=True, trim_blocks=True, lstrip_blocks=True)
    return environment.from_string(template).render(**page._asdict())


def png(title: str, path: Path, is_wide: bool = True) -> Picture:
    """A figure of a PNG file."""
    return Picture(title, data_url(path.read_bytes(), "png"), is_wide)


def data_url(content: bytes, kind: str) -> str:
    """A picture as text that stands in the page.

    Args:
      kind: its type, e.g. "svg+xml".
    """
    return f"data:image/{kind};base64,{base64.b64encode(content).decode()}"
