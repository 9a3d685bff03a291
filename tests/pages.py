"""The content of a page, for tests: its text, headings and pictures."""

from __future__ import annotations

import re
from html.parser import HTMLParser
from pathlib import Path

RAW = re.compile(r"[{\[]\s*['\"]|\b(None|nan|NaN|null|True|False)\b|\d\.\d{5,}|\de-\d\d")
"""Values as programs print them: JSON, Python's words, numbers that were not rounded."""


class Page(HTMLParser):
    """A parsed page.

    Attributes:
        text: all text that is shown.
        images: attributes of each picture.
        headings: (level, text) of each.
        ids: of its elements.
        links: targets of its links, and addresses of whatever else it loads.
    """

    def __init__(self, path: Path) -> None:
        super().__init__()
        self.images: list[dict[str, str]] = []
        self.headings: list[tuple[int, str]] = []
        self.ids: list[str] = []
        self.links: list[str] = []
        self._inside: list[str] = []
        self._parts: list[str] = []
        self.feed(path.read_text(encoding="utf-8"))
        self.text = " ".join(" ".join(self._parts).split())

    def handle_starttag(self, tag, attrs):
        given = {name: value or "" for name, value in attrs}
        if tag == "img":
            self.images.append(given)
        self.links += [given[name] for name in ("href", "src") if name in given]
        self.ids += [given["id"]] if "id" in given else []
        if tag in ("h1", "h2", "h3", "style", "code"):
            self._inside.append(tag)
            if tag[0] == "h":
                self.headings.append((int(tag[1]), ""))

    def handle_endtag(self, tag):
        if self._inside and self._inside[-1] == tag:
            self._inside.pop()

    def handle_data(self, data):
        inside = self._inside[-1] if self._inside else ""
        if inside == "style":
            return
        if inside[:1] == "h":
            level, text = self.headings[-1]
            self.headings[-1] = (level, text + data)
        self._parts.append(data)


def assert_fit_to_show(path: Path) -> Page:
    """Assert that a page can be shown: no raw values, pictures with descriptions, nothing from a network; return it."""
    page = Page(path)
    assert not RAW.search(page.text), RAW.search(page.text)
    for image in page.images:
        assert len(image["alt"]) > 20 and image["src"].startswith("data:image/")
    assert [text for level, text in page.headings if level == 1] and page.headings[0][0] == 1
    assert all(after <= before + 1 for (before, _), (after, _) in zip(page.headings, page.headings[1:], strict=False))
    assert all(text.strip() for _, text in page.headings)
    asked = [link for link in page.links if not link.startswith("data:")]
    for link in asked:
        file, _, rest = link.partition("#")
        assert rest in page.ids if not file else Path(file).name == "replay.html", link
        assert not file or (path.parent / file).is_file(), link
    source = path.read_text(encoding="utf-8")
    assert "prefers-color-scheme:dark" in source and "@media print" in source and "<html lang=en>" in source
    return page
