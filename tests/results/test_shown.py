"""What models, scenes, networks and ledgers say of themselves: one line, and a table in notebooks."""

from __future__ import annotations

import re
from html.parser import HTMLParser

import pytest

from phfmu import Monolithic, Options, PythonInstance, build_model, run
from phfmu.audit import audit_table
from phfmu.components.library import build
from phfmu.html import grid


class Text(HTMLParser):
    """The text of a page; tags must be closed."""

    def __init__(self, page: str):
        super().__init__()
        self.text, self.open = "", list[str]()
        self.feed(page)
        assert not self.open, self.open

    def handle_starttag(self, tag: str, attrs: object) -> None:
        self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.text += data + " "


def test_one_line_each() -> None:
    scene = build("smib")
    for thing in (scene, scene.system, scene.declaration(), build_model(build("dc_motor"))):
        assert repr(thing).startswith("<") and len(repr(thing)) < 200 and "\n" not in repr(thing)
    assert repr(build("dc_motor")) == "<PHDAE dc_motor: 2 states, 5 parameters, 2 ports>"
    assert repr(build("drive").system) == "<Network drive: 3 members, 2 junctions>"


def test_notebook_tables_tell_names_units_and_starts() -> None:
    shown = Text(build("dc_motor")._repr_html_()).text
    for word in ("flux Wb 0", "ohm 0.4", "terminal", "V, A", "winding current"):
        assert word in " ".join(shown.split()), word
    scene = Text(build("smib")._repr_html_()).text
    assert "0.5 s gen.shaft.torque" in scene and "gen.terminal, line.a" in scene and len(scene) < 4000
    assert "collocated" in Text(build_model(build("dc_motor"))._repr_html_()).text


def test_ledger_shows_its_table() -> None:
    model = build_model(build("dc_motor"))
    result = run(Monolithic(model, PythonInstance(model)), Options(stop=0.01, step=0.001))
    assert repr(result.ledger) == "<Ledger: 10 steps, 0 to 0.01 s>"
    page = result.ledger._repr_html_()
    assert "closed" in Text(page).text and "10 steps" in page and page.count("<table>") == 3


def test_numbers_stand_below_each_other_and_names_begin_at_the_left() -> None:
    page = grid("", ("name", "value"), [("a", "1"), ("b", ""), ("c", "-2e-3")])
    sides = re.findall(r"text-align:(\w+)", page)
    assert sides == ["left", "right"] * 4 and "<p>" not in page
    assert grid("empty", ("a",), []) == "<p><b>empty</b></p>"


def test_the_table_is_text_in_a_notebook_too(monkeypatch: pytest.MonkeyPatch) -> None:
    """rich shows what it prints as soon as it finds itself in a notebook."""
    model = build_model(build("dc_motor"))
    summary = run(Monolithic(model, PythonInstance(model)), Options(stop=0.01, step=0.001)).ledger.summary()
    expected = audit_table(summary)
    monkeypatch.setattr("rich.console._is_jupyter", lambda: True)
    assert audit_table(summary) == expected and "dc_motor" in expected
