"""The page of a running service: what a browser gets, what it shows, and what it refuses."""

from __future__ import annotations

import json
import shutil
import socket
import subprocess
import threading
import urllib.error
import urllib.request
from pathlib import Path

import pytest

from afdsvc.app import serve
from afdsvc.errors import BadInput
from afdsvc.files.site import Site, parse_site
from afdsvc.service.http_server import CONNECTIONS

BROWSER = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")


def site_of(port: int, folder: Path, web: str) -> Site:
    text = f"""
site = "hall-3"
[transport]
listen = ["tcp/127.0.0.1:{port}"]
[recording]
folder = "{folder}"
[web]
listen = "{web}"
[[machines]]
id = "bearing"
plant = "gas_bearing"
"""
    return parse_site(text, "site.toml")


def ask(url: str, method: str = "GET", **headers: str) -> tuple[int, bytes, str]:
    request = urllib.request.Request(url, method=method, headers=headers)
    try:
        with urllib.request.urlopen(request, timeout=10) as answer:
            return answer.status, answer.read(), answer.headers["Content-Type"]
    except urllib.error.HTTPError as error:
        with error:
            return error.code, error.read(), ""


def test_the_page_shows_and_nothing_else_is_answered(free_port, tmp_path):
    base = f"http://127.0.0.1:{free_port + 1}"
    with serve.serving(site_of(free_port, tmp_path, base.removeprefix("http://"))):
        status, page, kind = ask(base + "/")
        assert (status, kind) == (200, "text/html; charset=utf-8")
        assert b"http://" not in page.replace(b"http://www.w3.org", b"")  # nothing is fetched from elsewhere
        now = json.loads(ask(base + "/now.json")[1])
        assert now["status"]["site"] == "hall-3"
        assert now["status"]["machines"][0]["state"] == "absent"
        assert now["alarms"] == []
        assert ask(base + "/../../etc/passwd")[0] == 404
        assert ask(base + "/now.json", Host="evil.example")[0] == 403
        for method in ("POST", "PUT", "DELETE"):
            assert ask(base + "/", method)[0] == 501
        if BROWSER:
            command = [BROWSER, "--headless", "--no-sandbox", "--disable-gpu", f"--user-data-dir={tmp_path / 'browser'}"]
            seen = subprocess.run(
                [*command, "--virtual-time-budget=4000", "--dump-dom", base + "/"], capture_output=True, timeout=120, check=True
            ).stdout.decode()
            assert "no rig agent is connected" in seen
            assert "No alarm has ever been raised." in seen


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
