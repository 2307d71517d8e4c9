"""Pages that hold everything that they show, and take no text for HTML."""

import re
from html.parser import HTMLParser

import pytest

from eairl_jax.experiments.display import page

EVIL = '<script>alert("&")</script>'


class Parsed(HTMLParser):
    def __init__(self, text):
        super().__init__()
        self.tags, self.sources, self.text = [], [], []
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        self.sources += [value for name, value in attrs if name == "src"]

    def handle_data(self, data):
        self.text.append(data)


@pytest.fixture
def shown():
    table = page.Table(EVIL, ["", EVIL], [[EVIL, "2"]], EVIL)
    picture = page.Picture(EVIL, page.data_url(b"\x89PNG", "png"))
    link = page.Link(EVIL, "view/episode.html")
    content = page.Page(EVIL, EVIL, [table], [picture], [link], {EVIL: EVIL}, {EVIL: EVIL})
    return page.html(content)


def test_every_text_is_shown_as_it_is(shown):
    parsed = Parsed(shown)
    assert "script" not in parsed.tags
    assert "".join(parsed.text).count(EVIL) == 13
    for tag in ("table", "img", "a", "code", "details"):
        assert tag in parsed.tags


def test_no_request_leaves_the_page(shown):
    assert all(source.startswith("data:image/png;base64,") for source in Parsed(shown).sources)
    assert not re.search(r"https?:|@import|url\(", shown)
    assert "prefers-color-scheme: dark" in shown
    assert 'name="viewport"' in shown


def test_an_empty_part_has_no_heading():
    assert "<h2>" not in page.html(page.Page("title", "subtitle"))


def test_a_page_is_written_whole(tmp_path):
    page.write(tmp_path / "index.html", page.Page("a\udcff", "subtitle"))
    assert (tmp_path / "index.html").read_text(encoding="utf-8").startswith("<!doctype html>")
