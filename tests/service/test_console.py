"""The console of a running service: what a browser gets, what it shows, what people do on it, and what it refuses."""

from __future__ import annotations

import contextlib
import json
import socket
import threading
import time
import urllib.error
import urllib.request
from collections.abc import Iterator
from pathlib import Path

import pytest

from afdsvc.api.evidence import Evidence, Severity
from afdsvc.app import serve
from afdsvc.app.ask import ask_service
from afdsvc.errors import BadInput
from afdsvc.files.site import Site, parse_site
from afdsvc.service.console import STREAMS
from afdsvc.service.http_server import CONNECTIONS
from afdsvc.service.notifications import Judged
from afdsvc.wire.messages import Finding
from benchmarks.support.browser import Browser


def site_of(port: int, folder: Path, web: str, *machines: str) -> Site:
    text = f"""
site = "hall-3"
[transport]
listen = ["tcp/127.0.0.1:{port}"]
[recording]
folder = "{folder}"
[web]
listen = "{web}"
"""
    text += "".join(f'[[machines]]\nid = "{machine}"\nplant = "gas_bearing"\n' for machine in machines or ("bearing",))
    return parse_site(text, "site.toml")


def ask(url: str, method: str = "GET", **headers: str) -> tuple[int, bytes, str]:
    request = urllib.request.Request(url, method=method, headers=headers)
    try:
        with urllib.request.urlopen(request, timeout=10) as answer:
            return answer.status, answer.read(), answer.headers["Content-Type"]
    except urllib.error.HTTPError as error:
        with error:
            return error.code, error.read(), ""


def test_the_page_shows_and_nothing_else_is_answered(free_port, tmp_path, caplog):
    base = f"http://127.0.0.1:{free_port + 1}"
    with caplog.at_level("INFO"), serve.serving(site_of(free_port, tmp_path, base.removeprefix("http://"))):
        assert f"the operators' console is at {base}" in caplog.messages
        status, page, kind = ask(base + "/")
        assert (status, kind) == (200, "text/html; charset=utf-8")
        assert b"http://" not in page.replace(b"http://www.w3.org", b"")  # nothing is fetched from elsewhere
        now = json.loads(ask(base + "/now.json")[1])
        assert now["status"]["site"] == "hall-3"
        assert now["status"]["machines"][0]["state"] == "absent"
        assert now["alarms"] == []
        assert ask(base + "/../../etc/passwd")[0] == 404
        assert ask(base + "/now.json", Host="evil.example")[0] == 403
        for method, status in (("POST", 404), ("PUT", 501), ("DELETE", 501)):
            assert ask(base + "/", method)[0] == status


def post(base: str, cookie: str, name: str, **arguments) -> tuple[int, dict]:
    headers = {"X-Requested-With": "afdsvc", "Cookie": cookie}
    request = urllib.request.Request(base + "/act", json.dumps({"name": name, "arguments": arguments}).encode(), headers)
    try:
        with urllib.request.urlopen(request, timeout=20) as answer:
            return answer.status, json.load(answer)
    except urllib.error.HTTPError as error:
        with error:
            return error.code, json.loads(error.read() or b"{}")


def entered(url: str) -> str:
    """Return the cookie a link to sign in sets."""

    class Stay(urllib.request.HTTPRedirectHandler):
        def redirect_request(self, *args):
            return None

    with pytest.raises(urllib.error.HTTPError) as answer:
        urllib.request.build_opener(Stay).open(url, timeout=10)
    with answer.value as reply:
        return (reply.headers["Set-Cookie"] or "").partition(";")[0]


def an_alarm(hub) -> None:
    """Let the service hear of a fault: an alarm now, and four weeks in which it grew."""
    now = time.time_ns()
    found = Evidence("matched_filter", "bearing", 0, 5.0, 90.0, 4.0, True, burst="b1", fault="horizontal_actuator", severity=Severity(-0.2, 0.01))
    hub.alarms.take(Finding(found, "s", now), "bearing: horizontal_actuator -20 %")
    past = [Judged("bearing", f"w{day}", now - (28 - day) * 86400 * 10**9, "horizontal_actuator", -0.05 - 0.005 * day, 0.004) for day in range(29)]
    hub.history.add(*past)


def audited(site, count: int) -> list[tuple[str, str]]:
    """Return who did what, the service aside, once so many lines are written: they are written behind the answers."""
    end = time.monotonic() + 30
    while True:
        lines = [json.loads(line) for line in serve.audit_file(site).read_text().splitlines()]
        found = [(e["who"], e["what"]) for e in lines if e["who"] != "service"]
        if len(found) >= count or time.monotonic() > end:
            return found
        time.sleep(0.05)


def test_only_who_is_signed_in_acts_and_as_themselves(free_port, tmp_path, monkeypatch):
    base, site = f"http://127.0.0.1:{free_port + 1}", site_of(free_port, tmp_path, f"127.0.0.1:{free_port + 1}")
    with serve.serving(site) as hub:
        an_alarm(hub)
        alarm = "bearing/horizontal_actuator"
        assert post(base, "", "ack", alarm=alarm)[0] == 401
        assert post(base, "afdsvc-hall-3=guessed", "ack", alarm=alarm)[0] == 401
        url = ask_service(site, "console", "kim")["url"]
        cookie = entered(url)
        assert entered(url) == ""  # a link works once
        assert post(base, cookie, "ack", alarm=alarm, comment="seen")[1]["ok"]
        assert [(a["acknowledged_by"], a["comment"]) for a in ask_service(site, "alarms", "kim")] == [("kim", "seen")]
        status, reply = post(base, cookie, "shelve", alarm=alarm, minutes=60, comment="")
        assert (status, reply["ok"], "without a reason" in reply["error"]) == (200, False, True)
        assert audited(site, 3) == [("kim", "console"), ("kim", "ack"), ("kim", "shelve")]
        assert url.rpartition("/")[2] not in serve.audit_file(site).read_text()  # the link itself is not kept
        assert json.loads(ask(base + "/now.json")[1])["files"] == {}
        file = json.loads(ask(base + "/now.json", Cookie=cookie)[1])["files"][alarm]["recording"]
        assert ask(f"{base}/files/{file}")[0] == 404  # files are for who is signed in
        assert ask(f"{base}/files/{file}", Cookie=cookie)[1].startswith(b"\x89MCAP")
        assert ask(base + "/files/../site.toml", Cookie=cookie)[0] == 404
        own = urllib.request.Request(base + "/act", b"{}", {"Cookie": cookie})  # as a form of another page would ask
        with pytest.raises(urllib.error.HTTPError, match="404"):
            urllib.request.urlopen(own, timeout=10)
        monkeypatch.setattr("afdsvc.service.console.SIGNED_IN_SECONDS", -1.0)
        assert post(base, entered(ask_service(site, "console", "kim")["url"]), "ack", alarm=alarm)[0] == 401


def test_severities_are_kept_and_forecast(free_port, tmp_path):
    base, site = f"http://127.0.0.1:{free_port + 1}", site_of(free_port, tmp_path, f"127.0.0.1:{free_port + 1}")
    with serve.serving(site) as hub:
        assert json.loads(ask(base + "/trends.json")[1])["bearing"]["forecast"] is None
        an_alarm(hub)
        found = json.loads(ask(base + "/trends.json")[1])["bearing"]
        days = found["forecast"]["reaches"] - time.time() / 86400
        assert (found["fault"], found["bursts"], days) == ("horizontal_actuator", 29, pytest.approx(62, abs=0.1))
        assert found["forecast"]["earliest"] < found["forecast"]["reaches"] < found["forecast"]["latest"]
        hub.history.add(Judged("bearing", "w28", time.time_ns(), "horizontal_actuator", -0.5, 0.004))  # a later decision on the same burst
        assert len(hub.history.judged("bearing")) == 29


def events(stream) -> Iterator[tuple[str, dict]]:
    """Yield the name and the value of every event of a stream."""
    for line in stream:
        if line.startswith(b"event: "):
            yield line[7:].decode().strip(), json.loads(next(stream)[6:])


def test_a_stream_says_what_changes_and_ends_with_the_service(free_port, tmp_path):
    base, site = f"http://127.0.0.1:{free_port + 1}", site_of(free_port, tmp_path, f"127.0.0.1:{free_port + 1}")
    with serve.serving(site) as hub:
        cookie = entered(ask_service(site, "console", "kim")["url"])
        stream = urllib.request.urlopen(urllib.request.Request(base + "/events", headers={"Cookie": cookie}), timeout=20)
        assert stream.headers["Content-Type"] == "text/event-stream"
        heard = events(stream)
        (_, now), (_, trends) = next(heard), next(heard)
        assert (now["status"]["site"], now["who"], now["alarms"], trends["bearing"]["points"]) == ("hall-3", "kim", [], [])
        known = hub.changes
        an_alarm(hub)
        assert hub.changes > known  # which a stream waits for
        now = next(value for name, value in heard if name == "now" and value["alarms"])
        assert now["alarms"][0]["id"] in now["files"]
        assert next(value for name, value in heard if name == "trends")["bearing"]["bursts"] == 29
        with urllib.request.urlopen(base + "/events", timeout=20) as other:
            an_alarm(hub)
            assert next(value for name, value in events(other) if value.get("alarms"))["files"] == {}  # files are for who is signed in
        assert ask(base + "/events", Host="evil.example")[0] == 403
    with stream:
        assert sum(1 for _ in zip(range(10), heard, strict=False)) < 10  # it ends


def test_streams_are_bounded_and_a_place_is_given_back(free_port, tmp_path):
    base = f"http://127.0.0.1:{free_port + 1}"
    with serve.serving(site_of(free_port, tmp_path, base.removeprefix("http://"))):
        streams = [urllib.request.urlopen(base + "/events", timeout=20) for _ in range(STREAMS)]
        assert [next(events(s))[0] for s in streams] == ["now"] * STREAMS
        assert ask(base + "/events")[0] == 503
        assert ask(base + "/now.json")[0] == 200  # the others ask
        for s in streams:
            s.close()
        end = time.monotonic() + 30
        while time.monotonic() < end:
            with contextlib.suppress(urllib.error.HTTPError), urllib.request.urlopen(base + "/events", timeout=20) as freed:
                assert next(events(freed))[0] == "now"
                break
            time.sleep(0.1)
        else:
            raise AssertionError("no place was given back")


def a_burst_is_shown(browser: Browser, hub) -> None:
    """Check the dialog of a planned burst: a panel each for its channels, the limit of the signal that is shown, nothing clipped."""
    assert browser.value("[...document.querySelectorAll('#ask td')].some((e) => e.textContent === 'output horizontal')")
    assert "Excitation signal alpha, added inside the controller (not the actuator command)" in browser.value("document.getElementById('ask').innerText")
    limit = hub.burst_requests["bearing"].pipeline.problem.limits.alpha
    panels = browser.value("[...document.querySelectorAll('#ask figure')].map((e) => [e.querySelector('figcaption').innerText, ...[...e.querySelectorAll('text')].map((t) => t.textContent)])")
    assert [panel[0].split(":")[0] for panel in panels] == ["horizontal", "vertical"]  # none hides the other
    for panel, bound in zip(panels, limit, strict=True):
        assert f"limit of this signal {bound:.3g} V" in panel[0]
        assert {"0", "time [s]", "alpha [V]"} <= set(panel)
        assert all(len(word) <= 6 for word in panel[1:-2]), panel  # multiples of a round step
    inside = "(e) => { const box = e.getBoundingClientRect(); return [...e.querySelectorAll('text')].map((t) => t.getBoundingClientRect()).every((t) => t.left >= box.left && t.right <= box.right && t.top >= box.top && t.bottom <= box.bottom); }"
    assert browser.value(f"[...document.querySelectorAll('#ask svg')].every({inside})")


def test_an_alarm_is_handled_by_keyboard_alone(free_port, tmp_path, browser):
    base, site = f"http://127.0.0.1:{free_port + 1}", site_of(free_port, tmp_path, f"127.0.0.1:{free_port + 1}")
    with serve.serving(site) as hub:
        browser.open(base + "/", 1400)
        browser.until("document.body.innerText.includes('No alarm has ever been raised.')")
        browser.until("document.body.innerText.includes('read only')")
        an_alarm(hub)
        browser.until("document.body.innerText.includes('not acknowledged')")
        browser.until("document.getElementById('news').textContent.includes('bearing/horizontal_actuator')")  # announced to screen readers
        assert browser.value("document.title").startswith("(1) ")
        assert browser.value("document.querySelectorAll('button:not(dialog button)').length") == 0
        browser.open(ask_service(site, "console", "kim")["url"], 400)
        browser.until("document.body.innerText.includes('signed in: kim')")
        browser.tab_to("Acknowledge bearing/horizontal_actuator")
        time.sleep(2.5)  # the page is drawn anew; the place is kept
        browser.press("Enter")
        browser.until("document.getElementById('ask').open")
        browser.type("on my way")
        browser.press("Enter")
        browser.until("document.body.innerText.includes('acknowledged by kim')")
        browser.until("document.activeElement.id === 'machine-bearing'")  # the button is gone; the keyboard stays at its machine
        (seen,) = ask_service(site, "alarms", "lee")
        assert (seen["acknowledged"], seen["acknowledged_by"], seen["comment"]) == (True, "kim", "on my way")
        browser.tab_to("Shelve bearing/horizontal_actuator")
        browser.press("Enter")
        browser.until("document.getElementById('ask').open")
        browser.press("Escape")
        browser.until("!document.getElementById('ask').open")
        browser.tab_to("Show and play a burst on bearing")
        browser.press("Enter")
        browser.until("document.getElementById('ask').innerText.includes('Expected peaks')")
        a_burst_is_shown(browser, hub)
        assert browser.unnamed() == []
        browser.tab_to("Play")
        browser.press("Enter")
        browser.until("document.getElementById('ask-error').textContent.includes(\"'bearing' is not connected\")")
        browser.press("Escape")
        browser.until("document.body.innerText.includes('it is reached on')")  # the forecast
        shown = browser.value("document.body.innerText")  # of a machine that is absent, with estimates by earlier bursts
        assert [words for words in ("No burst has been judged", "next burst", "no burst planned") if words in shown] == []
        for width in (400, 1400):
            browser.open(base + "/", width)
            browser.until("document.body.innerText.includes('it is reached on')")
            assert browser.value("document.documentElement.scrollWidth") <= width  # nothing is off the screen
            assert browser.unnamed() == []
            browser.picture(tmp_path / f"console-{width}.png")
        assert browser.errors == []


def test_the_page_hears_by_itself_and_asks_where_it_cannot(free_port, tmp_path, browser):
    base, site = f"http://127.0.0.1:{free_port + 1}", site_of(free_port, tmp_path, f"127.0.0.1:{free_port + 1}")
    with serve.serving(site) as hub:
        browser.open(base + "/", 1400)
        browser.until("stream && stream.readyState === EventSource.OPEN && pushed > 0")
        browser.value("window.fetch = () => Promise.reject(new Error('nothing is asked'))")
        an_alarm(hub)
        browser.until("document.body.innerText.includes('not acknowledged')")
        browser.until("document.body.innerText.includes('it is reached on')")  # the trend came by itself too
        assert "nothing is asked" not in browser.value("document.body.innerText")
    browser.until("document.getElementById('about').textContent.includes('does not answer')")
    browser.open("about:blank", 1400)  # the page would take a place again
    with serve.serving(site):
        streams = [urllib.request.urlopen(base + "/events", timeout=20) for _ in range(STREAMS)]
        browser.open(base + "/", 1400)
        browser.until("performance.now() > 5000 && pushed < 0 && document.getElementById('about').textContent.includes('up ')")
        before = browser.value("document.getElementById('about').textContent")
        browser.until(f"document.getElementById('about').textContent !== {json.dumps(before)}")
        for s in streams:
            s.close()
        browser.until("pushed > 0")  # a place is taken as soon as one is free


def test_a_fault_somebody_has_seen_stays_in_sight_and_the_worst_comes_first(free_port, tmp_path, browser):
    names = ("healthy", "gone", "shelved", "small", "seen", "open")
    site = site_of(free_port, tmp_path, f"127.0.0.1:{free_port + 1}", *names)
    with serve.serving(site) as hub:
        for name, severity in (("shelved", -0.9), ("small", -0.1), ("seen", -0.505), ("open", -0.05)):
            found = Evidence("matched_filter", name, 0, 5.0, 90.0, 4.0, True, burst="b1", fault="vertical_sensor", severity=Severity(severity, 0.01))
            hub.alarms.take(Finding(found, "s", time.time_ns()), "a fault")
        hub.alarms.shelve("shelved/vertical_sensor", "kim", 10, "why", time.time_ns())
        hub.alarms.acknowledge("small/vertical_sensor", "kim")
        hub.alarms.confirm("small/vertical_sensor", "kim", "", time.time_ns())
        hub.alarms.acknowledge("seen/vertical_sensor", "kim")
        browser.open(f"http://127.0.0.1:{free_port + 1}/", 1400)
        browser.until("document.querySelectorAll('nav li').length === 6")
        browser.value("if (stream) stream.close(); pushed = Infinity; now.status.machines.find((m) => m.machine === 'healthy').state = 'running'; now.residuals.healthy = { t: [1, 2, 3], level: [0.5, 2, 0.5], burst: [0, 1, 0] }; show()")
        assert browser.value("[...document.querySelectorAll('nav li')].map((e) => e.innerText.replace(/\\s+/g, ' '))") == [
            "open vertical_sensor -5.0 ± 1.0 % absent", "seen vertical_sensor -50.5 ± 1.0 %, acknowledged absent",
            "small vertical_sensor -10.0 ± 1.0 %, confirmed absent", "shelved vertical_sensor -90.0 ± 1.0 %, shelved absent", "gone absent", "healthy running",
        ]  # fmt: skip
        shown = browser.value("document.getElementById('machine-healthy').innerText")
        assert "divided by its alarm threshold (dashed line: the threshold, crossed by noise about once a day). Brown dots: during bursts." in shown
        assert "No burst has been judged yet" in shown
        rows = "[...document.querySelectorAll('#alarms tr')].slice(1).map((r) => [...r.cells].slice(1).map((c) => c.innerText))"
        assert browser.value(rows) == [  # who is not signed in may do nothing
            ["open", "vertical_sensor -5.0 ± 1.0 %", "active"], ["seen", "vertical_sensor -50.5 ± 1.0 %", "active, acknowledged"],
            ["small", "vertical_sensor -10.0 ± 1.0 %", "active, confirmed"], ["shelved", "vertical_sensor -90.0 ± 1.0 %", "active, shelved"],
        ]  # fmt: skip
        browser.open(ask_service(site, "console", "kim")["url"], 400)
        browser.until("document.querySelectorAll('#alarms button').length === 2")
        assert browser.value("document.querySelector('#alarms').scrollWidth") <= 400
        browser.value("document.querySelector('#alarms button').click()")
        browser.until("document.getElementById('ask').open")
        browser.press("Enter")
        browser.until("document.querySelectorAll('#alarms button').length === 1")
        assert hub.alarms.alarms["open/vertical_sensor"].acknowledged_by == "kim"
        assert browser.unnamed() == []
        assert browser.errors == []


def test_long_names_wrap_on_a_phone(free_port, tmp_path, browser):
    machine, fault = "spindle_with_a_rather_long_name_of_hall_7_north", "gain_of_the_horizontal_actuator_beside_the_gearbox"
    with serve.serving(site_of(free_port, tmp_path, f"127.0.0.1:{free_port + 1}", machine)) as hub:
        hub.alarms.take(Finding(Evidence("matched_filter", machine, 0, 5.0, 20.5, 20.2, True, fault=fault), "s", time.time_ns()), "a fault")
        browser.open(f"http://127.0.0.1:{free_port + 1}/", 400)
        browser.until("document.body.innerText.includes('not acknowledged')")
        assert browser.value("document.documentElement.scrollWidth") <= 400


def test_one_fault_is_one_alarm(free_port, tmp_path, browser):
    base, site = f"http://127.0.0.1:{free_port + 1}", site_of(free_port, tmp_path, f"127.0.0.1:{free_port + 1}")
    with serve.serving(site) as hub:
        unnamed = Evidence("passive_cusum", "bearing", 0, 5.0, 20.5, 20.2, True)
        hub.alarms.take(Finding(unnamed, "s", time.time_ns()), "bearing: a fault")
        an_alarm(hub)
        hub.alarms.group("bearing", "horizontal_actuator", time.time_ns())
        browser.open(base + "/", 1400)
        browser.until("document.body.innerText.includes('What follows from it: a fault, not isolated')")
        assert browser.value("document.querySelectorAll('section > .alarm').length") == 1
        assert browser.value("document.title").startswith("(1) ")
        browser.value("document.querySelector('summary').click()")
        time.sleep(2.5)  # the page is drawn anew; what was opened stays open
        browser.until("document.querySelector('details').open && document.body.innerText.includes('follows from bearing/horizontal_actuator')")
        assert browser.errors == []


def test_decisions_bear_the_clocks_time_as_alarms_do(free_port, tmp_path, browser):
    base, site = f"http://127.0.0.1:{free_port + 1}", site_of(free_port, tmp_path, f"127.0.0.1:{free_port + 1}")
    with serve.serving(site) as hub:
        found = Evidence("matched_filter", "bearing", 0, 5.0, 90.0, 4.0, True, burst="b1", fault="horizontal_actuator")
        hub.watches["bearing"].findings.append(Finding(found, "s", 1_764_000_000 * 10**9))
        assert json.loads(ask(base + "/now.json")[1])["decisions"]["bearing"][0]["t_ns"] == 1_764_000_000 * 10**9
        browser.open(base + "/", 1400)
        browser.until("document.body.innerText.includes('The last decisions on bursts')")
        row = "[...document.querySelectorAll('tr')].find((r) => r.innerText.includes('matched_filter')).cells[0].innerText"
        clock = "(() => { const d = new Date(1764000000000); return String(d.getHours()).padStart(2, '0') + ':' + String(d.getMinutes()).padStart(2, '0') + ':00'; })()"
        assert browser.value(row).endswith(browser.value(clock))
        browser.open(base + "/", 400)
        browser.until("document.querySelectorAll('.wide').length === 1")
        assert browser.value("(() => { const e = document.querySelector('.wide'); return e.scrollWidth - e.clientWidth; })()") == 0  # nothing to be scrolled to
        assert browser.errors == []


@pytest.mark.parametrize(
    ("web", "sentence"),
    [("0.0.0.0:8080", "readable from other computers"), ("8080", "host:port"), ("nowhere", "host:port")],
)
def test_an_address_that_is_open_or_none_is_refused(web, sentence, free_port, tmp_path):
    with pytest.raises(BadInput, match=sentence):
        site_of(free_port, tmp_path, web)


def test_a_taken_address_is_named(free_port, tmp_path):
    with pytest.raises(BadInput, match=r"web\.listen = '127\.0\.0\.1"), serve.serving(
        site_of(free_port, tmp_path, f"127.0.0.1:{free_port}")
    ):
        pass


def test_connections_left_half_open_are_bounded_and_others_are_served(free_port, tmp_path, caplog, capfd):
    address = ("127.0.0.1", free_port + 1)
    before = threading.active_count()
    with serve.serving(site_of(free_port, tmp_path, f"127.0.0.1:{free_port + 1}")):
        started = threading.active_count()
        half_open = [socket.create_connection(address) for _ in range(200)]
        try:
            for s in half_open:
                s.sendall(b"GET / HTTP/1.1\r\n")
            status, page, _ = ask(f"http://127.0.0.1:{free_port + 1}/")
            assert status == 200
            assert threading.active_count() - started <= CONNECTIONS + 3
        finally:
            for s in half_open:  # hang up in the middle of a request
                s.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, b"\1\0\0\0\0\0\0\0")
                s.close()
        status, _, _ = ask(f"http://127.0.0.1:{free_port + 1}/")
        assert status == 200
    assert threading.active_count() <= before + CONNECTIONS
    assert "Traceback" not in caplog.text + capfd.readouterr().err


def test_a_supervisor_learns_whether_the_service_is_healthy_and_ready(free_port, tmp_path, monkeypatch):
    base = f"http://127.0.0.1:{free_port + 1}"
    with serve.serving(site_of(free_port, tmp_path, base.removeprefix("http://"))) as hub:
        assert [ask(f"{base}/{name}")[:2] for name in ("healthz", "readyz")] == [(200, b"yes\n")] * 2
        monkeypatch.setattr(hub, "recording", lambda: ("", 0, "disk full", 0))
        assert [ask(f"{base}/{name}")[0] for name in ("healthz", "readyz")] == [200, 503]
        monkeypatch.setattr(hub, "healthy", lambda: False)
        assert [ask(f"{base}/{name}")[0] for name in ("healthz", "readyz")] == [503, 503]
