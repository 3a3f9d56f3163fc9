"""The page of a running service: what a browser gets, what it shows, and what it refuses."""

from __future__ import annotations

import json
import shutil
import subprocess
import urllib.error
import urllib.request
from pathlib import Path

import pytest

from afdsvc.app import serve
from afdsvc.errors import BadInput
from afdsvc.files.site import Site, parse_site

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
