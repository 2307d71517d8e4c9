"""Terminals whose encoding lacks characters: every text is printed, with other characters in the place of these.

This file imports nothing, so that help is fast.
"""

from __future__ import annotations

import codecs
import sys

NAME = "eairl_plain"
SUBSTITUTES = {"±": "+-", "…": "...", "•": "*", "·": "*", "×": "x", "–": "-", "—": "-", "│": "|", "─": "-", "━": "-"}


def encodable(text: str, encoding: str) -> str:
    """The text with substitutes for the characters that an encoding lacks."""
    return text.encode(encoding, NAME).decode(encoding)


def _substitute(error: UnicodeError) -> tuple[str, int]:
    if not isinstance(error, UnicodeEncodeError):
        raise error
    characters = error.object[error.start : error.end]
    return "".join(SUBSTITUTES.get(each) or ascii(each)[1:-1] for each in characters), error.end


codecs.register_error(NAME, _substitute)


def print_anything() -> None:
    """Lets the standard streams print every text."""
    for stream in (sys.stdout, sys.stderr):
        if stream is not None and hasattr(stream, "reconfigure"):
            stream.reconfigure(errors=NAME)
