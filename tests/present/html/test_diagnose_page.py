"""A diagnosis as a page: the answers of the document, in words, and every decision."""

from __future__ import annotations

from html.parser import HTMLParser
from pathlib import Path

import pytest

from afdsvc.app.diagnose import diagnose_recordings
from afdsvc.errors import BadInput
from afdsvc.present.html.diagnose_page import diagnose_page, verdict_words, write_diagnosis

SHIPPED = Path(__file__).parents[3] / "recordings" / "shipped"


class Words(HTMLParser):
    def __init__(self, page: str):
        super().__init__()
        self.words, self.tags, self.sources = [], [], []
        self.feed(page)

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        self.sources += [value for name, value in attrs if name in ("src", "href", "xlink:href") and not value.startswith("#")]

    def handle_data(self, data):
        self.words.append(data)

    @property
    def text(self) -> str:
        return " ".join(" ".join(self.words).split())


@pytest.fixture(scope="module")
def document():
    names = ("nominal", "vertical_sensor")
    return diagnose_recordings([SHIPPED / f"gas_bearing_{name}.mcap" for name in names], detectors=("regression",))


def test_every_recording_is_answered_and_every_decision_stands_in_the_table(document):
    page = Words(diagnose_page(document))
    assert "Nothing is wrong" in page.text
    assert "Fault: vertical_sensor" in page.text
    faulty = document["recordings"][1]
    severity = faulty["verdict"]["severity"]
    assert f"{100 * severity['value']:.1f} ± {100 * severity['sd']:.1f} %" in page.text
    decisions = sum(len(b["decisions"]) for r in document["recordings"] for b in r["bursts"])
    assert page.text.count("regression") == decisions
    assert page.tags.count("svg") == 2  # wide and for phones
    assert not page.sources, "nothing comes from outside"


def test_a_decision_without_numbers_is_shown_without_them(document):
    """As one whose burst lies in a damaged part of the recording."""
    recording = document["recordings"][0]
    (burst, *_) = recording["bursts"]
    unread = {**burst["decisions"][0], "statistic": None, "threshold": None, "trustworthy": False, "reason": "samples are missing"}
    page = diagnose_page({"recordings": [{**recording, "bursts": [{**burst, "decisions": [unread]}]}]})
    assert "not trustworthy: samples are missing" in page


def test_names_cannot_break_out_of_the_page(document):
    evil = {**document["recordings"][0], "recording": "<script>alert(1)</script>"}
    assert "<script>alert" not in diagnose_page({"recordings": [evil]})


def test_a_page_that_cannot_be_written_is_named(document, tmp_path):
    with pytest.raises(BadInput, match=r"nowhere/page\.html: cannot be written: No such file"):
        write_diagnosis(document, tmp_path / "nowhere" / "page.html")
    write_diagnosis(document, tmp_path / "page.html")
    assert (tmp_path / "page.html").read_text().startswith("<!doctype html>")


@pytest.mark.parametrize(
    ("verdict", "words"),
    [
        ({"fault": None, "first_detected_s": 3.0, "trustworthy": True}, "A fault, cause open"),
        ({"fault": None, "first_detected_s": None, "trustworthy": False}, "No answer"),
        ({"fault": None, "first_detected_s": None, "trustworthy": True}, "Nothing is wrong"),
    ],
)
def test_what_is_not_known_is_not_called_healthy(verdict, words):
    assert verdict_words(verdict) == words
