"""Figures on pages: what is drawn is in the page as numbers, and in a browser they zoom and give their data away."""

from __future__ import annotations

import csv
import json
import re
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure

from afdsvc.present.html import render, svg, zoomable
from benchmarks.support.browser import CHROMIUM, NO_CHROMIUM, Browser

browser_needed = pytest.mark.skipif(CHROMIUM is None, reason=NO_CHROMIUM)
T = np.linspace(0.0, 10.0, 201)
WIDE = f"<table><tr>{'<th>a long name of a column</th>' * 6}</tr><tr>{'<td>a value of some words</td>' * 6}</tr></table>"


def drawn() -> str:
    figure = Figure(figsize=(8, 4), layout="constrained")
    top, bottom = figure.subplots(2, 1)
    top.plot(T, np.sin(T), label="measured, first")
    top.axhline(0.5)
    top.set(xlabel="time [s]", ylabel="speed [rpm]")
    bottom.loglog(T[1:], T[1:] ** 2, "o-", label="spectrum")
    bottom.fill_between(T[1:], T[1:], T[1:] ** 3, label="band")
    return zoomable(figure)


def test_numbers_of_logarithmic_axes_are_text_and_less_than_a_decade_has_some():
    figure = Figure(figsize=(4, 4), layout="constrained")
    wide, narrow = figure.subplots(2, 1)
    wide.loglog([1, 1000], [1e-5, 1e2])
    narrow.semilogy([0, 1], [2.1, 7.9])
    text = svg(figure)
    assert all(f"<!-- {n} -->" in text for n in ("0.0001", "10", "1000", "3", "7"))
    assert "mathdefault" not in text
    assert figure.dpi == Figure().dpi


def stacked() -> str:
    """Return a figure of three panels: a close-up, and two over one time axis, whose name stands below the lowest."""
    figure = Figure(figsize=(8, 5), layout="constrained")
    axes = figure.subplots(3, 1)
    axes[0].plot(T[:50], T[:50], label="close-up")
    for ax in axes[1:]:
        ax.plot(T, np.sin(T), label="measured")
        ax.plot(T, np.cos(T), label="a name that is too long for two columns")
        ax.legend()
    axes[2].set_xlabel("time [s]")
    return zoomable(figure)


@browser_needed
@pytest.mark.parametrize(("width", "kind"), [(1000, "wide"), (400, "phone")])
def test_panels_of_one_time_axis_zoom_together_and_a_legend_on_a_phone_hides_no_curve(tmp_path, width, kind):
    page, browser = tmp_path / "page.html", Browser(tmp_path / "browser")
    page.write_text(render("page.html.j2").replace("<script>", f"<h2>Courses</h2>{stacked()}<script>", 1), encoding="utf-8")
    try:
        browser.open(page.as_uri(), width)
        browser.until("document.querySelectorAll('.tools button').length === 14")
        part = f"document.querySelector('figure.{kind} [id=\"axes-%d\"] %s')"
        x, y, w, h = browser.value(f"(({{x, y, width, height}}) => [x, y, width, height])({part % (1, 'path')}.getBoundingClientRect())")
        for event, share in (("mousePressed", 0.2), ("mouseMoved", 0.3), ("mouseReleased", 0.4)):
            browser.call("Input.dispatchMouseEvent", type=event, x=x + share * w, y=y + 0.5 * h, button="left", clickCount=1)
        shown = f"(() => {{ const found = {part}; return found ? [...found.parentElement.querySelectorAll(':scope > text[text-anchor=middle]')].map((e) => e.textContent) : []; }})()"
        first, middle, last = (browser.value(shown % (k, "> g:last-child > text")) for k in range(3))
        assert first == []
        assert len(middle) > 2
        assert middle == last
        if kind == "phone":
            bottom, top = (browser.value(f"{part % (1, what)}.getBoundingClientRect().{edge}") for what, edge in (("path", "bottom"), ("[id^=legend]", "top")))
            end, next_one = browser.value(f"{part % (1, '[id^=legend]')}.getBoundingClientRect().bottom"), browser.value(f"{part % (2, 'path')}.getBoundingClientRect().top")
            assert bottom < top < end < next_one
        browser.picture(tmp_path / f"stacked-{kind}.png")
    finally:
        browser.close()


def test_the_numbers_of_every_curve_are_in_the_page():
    found = json.loads(re.search(r'<script type="application/json">(.*?)</script>', drawn()).group(1))
    assert [[s["name"] for s in ax["series"]] for ax in found] == [["measured, first"], ["spectrum", "band"]]
    assert found[0]["series"][0]["x"] == pytest.approx(T, abs=1e-5)
    assert found[0]["series"][0]["y"] == pytest.approx(np.sin(T), abs=1e-5)
    assert (found[0]["y_name"], found[1]["log"]) == ("speed [rpm]", [True, True])


@pytest.fixture
def opened(tmp_path):
    """Open a page with a figure and a table at a width."""
    page, browser = tmp_path / "page.html", Browser(tmp_path / "browser")
    page.write_text(render("page.html.j2").replace("<script>", f"<h2>The motor</h2>{drawn()}{WIDE}<script>", 1), encoding="utf-8")
    browser.call("Page.setDownloadBehavior", behavior="allow", downloadPath=str(tmp_path))

    def at(width: int) -> Browser:
        browser.open(page.as_uri(), width)
        browser.until("document.querySelectorAll('.tools button').length === 14")
        return browser

    yield at
    browser.close()


@browser_needed
def test_in_print_a_heading_stays_with_its_figure(opened):
    browser = opened(1000)
    browser.call("Emulation.setEmulatedMedia", media="print")
    browser.value("document.querySelector('figure').insertAdjacentHTML('beforebegin', '<h3>Part</h3><p>What is shown.</p>')")
    for element in ("h2", "h3", "h3 + p"):
        assert browser.value(f"getComputedStyle(document.querySelector('{element}')).breakAfter") == "avoid"
    assert browser.value("getComputedStyle(document.querySelector('figure')).breakInside") == "avoid"


def measured(browser: Browser, folder: Path) -> list[float]:
    """Return the curve 'measured, first' as the page saves it."""
    saved = folder / "the-motor.csv"
    browser.tab_to("save as CSV: The motor")
    browser.press("Enter")
    for _ in range(100):
        if saved.exists() and saved.stat().st_size > 1000:
            break
        browser.value("new Promise((go) => setTimeout(go, 50))")
    return [float(row["y"]) for row in csv.DictReader(saved.read_text().splitlines()) if row["series"] == "measured, first"]


@browser_needed
def test_figures_zoom_and_are_saved_in_a_browser(tmp_path, opened):
    browser = opened(1000)
    shown = "[...document.querySelectorAll('svg [id=\"axes-0\"] > g:last-child text')].map((e) => e.textContent)"
    assert browser.value(shown) == []
    browser.tab_to("zoom in: The motor")
    browser.press("Enter")
    numbers = [float(text) for text in browser.value(shown)]
    assert min(n for n in numbers if n > 1.5) >= 2.5  # the middle half of the time axis
    assert max(numbers) <= 7.5 + 0.3  # a margin of the axis is halved too
    where = browser.value("(() => { const r = document.querySelector('svg [id=\"axes-0\"] path').getBoundingClientRect(); return [r.x, r.y, r.width, r.height]; })()")
    browser.tab_to("show everything: The motor")
    browser.press("Enter")
    assert browser.value(shown) == []
    x, y, width, height = where
    for kind, share in (("mousePressed", 0.2), ("mouseMoved", 0.3), ("mouseReleased", 0.4)):
        browser.call("Input.dispatchMouseEvent", type=kind, x=x + share * width, y=y + 0.5 * height, button="left", clickCount=1)
    dragged = [float(text) for text in browser.value(shown)]
    assert any(1.5 < n < 4.0 for n in dragged)
    assert max(dragged) < 4.1
    assert measured(browser, tmp_path) == pytest.approx(np.sin(T), abs=1e-5)
    assert browser.unnamed() == []
    assert browser.errors == []


@browser_needed
def test_a_phone_gets_figures_and_tables_that_fit(tmp_path, opened):
    browser = opened(400)
    assert browser.value("document.documentElement.scrollWidth") <= 400
    seen = "[...document.querySelectorAll('figure')].filter((f) => getComputedStyle(f).visibility === 'visible')"
    assert browser.value(f"{seen}.map((f) => f.className)") == ["plot phone"]
    figure = f"{seen}[0].querySelector('svg')"
    left, right, hidden = browser.value(f"(({{left, right}}) => [left, right, {figure}.parentElement.scrollWidth - {figure}.parentElement.clientWidth])({figure}.getBoundingClientRect())")
    assert 0 <= left < right <= 400
    assert hidden <= 0  # nothing scrolls sideways
    sizes = browser.value(f"[...{figure}.querySelectorAll('[id^=\"text_\"]')].map((e) => e.getBoundingClientRect().height).filter((h) => h > 0)")
    assert min(sizes) >= 6  # CSS pixels: digits of 7 points
    browser.tab_to("zoom in: The motor")
    browser.press("Enter")
    assert browser.value(f"[...{figure}.querySelectorAll('[id=\"axes-0\"] > g:last-child text')].length") > 3
    assert measured(browser, tmp_path) == pytest.approx(np.sin(T), abs=1e-5)  # a phone saves the same numbers
    shown = "[...document.querySelectorAll('td')].map((e) => [e.getBoundingClientRect().right, getComputedStyle(e, '::before').content])"
    assert all(right <= 400 and name == '"a long name of a column"' for right, name in browser.value(shown))  # a wide table is cards on a phone
    assert browser.errors == []


def test_a_dollar_in_a_name_begins_no_formula():
    figure = Figure(layout="constrained")
    ax = figure.subplots()
    ax.loglog([1, 10], [1, 10], label=r"cost $\frac$")
    ax.set(title=r"y [$\frac$]", xlabel=r"$\frac$", ylabel=r"$\frac$")
    ax.legend()
    assert "<svg" in zoomable(figure)
