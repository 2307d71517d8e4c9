"""Every text can be printed in every encoding."""

import io

import pytest

from eairl_jax.experiments.display import plain


@pytest.mark.parametrize(
    ("text", "encoding", "expected"),
    [
        ("1 ± 2 …", "ascii", "1 +- 2 ..."),
        ("ä ± \u2603", "latin-1", "ä ± \\u2603"),
        ("ä ± \u2603", "utf-8", "ä ± \u2603"),
        ("\U0001f600 é", "ascii", "\\U0001f600 \\xe9"),
    ],
)
def test_characters_that_an_encoding_lacks_have_substitutes(text, encoding, expected):
    assert plain.encodable(text, encoding) == expected


def test_the_standard_streams_print_anything(monkeypatch):
    stream = io.TextIOWrapper(io.BytesIO(), encoding="ascii")
    monkeypatch.setattr("sys.stdout", stream)
    monkeypatch.setattr("sys.stderr", None)  # as under pythonw
    plain.print_anything()
    print("• 1 ± 2")
    stream.flush()
    assert stream.buffer.getvalue() == b"* 1 +- 2\n"
