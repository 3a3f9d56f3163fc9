"""A real browser for tests: Chromium without a screen, driven by its own protocol over a pipe."""

from __future__ import annotations

import base64
import json
import os
import shutil
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
NO_CHROMIUM = "no browser to test in: install chromium (Debian: apt-get install chromium) or google-chrome, so that it is in PATH"


class Browser:
    """One page. ``errors`` collects what the page's own console reports."""

    def __init__(self, folder: Path) -> None:
        assert CHROMIUM
        (to, self._write), (self._read, back) = os.pipe(), os.pipe()
        flags = ["--headless", "--no-sandbox", "--disable-gpu", "--no-first-run", "--hide-scrollbars", f"--user-data-dir={folder}", "--remote-debugging-pipe"]
        # The protocol's pipes are descriptors 3 and 4, by Chromium's own convention.
        place = f"import os, sys; os.dup2({to}, 100); os.dup2({back}, 101); os.dup2(100, 3); os.dup2(101, 4); os.execv(sys.argv[1], sys.argv[1:])"
        command = [sys.executable, "-c", place, CHROMIUM, *flags]
        self._process = subprocess.Popen(command, pass_fds=(to, back), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        os.close(to)
        os.close(back)
        self._rest, self._number, self._session, self.errors = b"", 0, "", list[str]()
        target = self.call("Target.createTarget", url="about:blank")["targetId"]
        self._session = self.call("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
        for domain in ("Page", "Runtime", "Log", "Accessibility"):
            self.call(f"{domain}.enable")

    def close(self) -> None:
        self._process.terminate()
        self._process.wait(10)
        os.close(self._write)
        os.close(self._read)

    def call(self, method: str, **parameters: Any) -> dict[str, Any]:
        self._number += 1
        asked = {"id": self._number, "method": method, "params": parameters} | ({"sessionId": self._session} if self._session else {})
        os.write(self._write, json.dumps(asked).encode() + b"\0")
        while (said := self._message()).get("id") != self._number:
            self._note(said)
        assert "error" not in said, f"{method}: {said['error']}"
        return said["result"]

    def _message(self) -> dict[str, Any]:
        while b"\0" not in self._rest:
            piece = os.read(self._read, 1 << 20)
            assert piece, "the browser has ended"
            self._rest += piece
        line, self._rest = self._rest.split(b"\0", 1)
        return json.loads(line)

    def _note(self, said: dict[str, Any]) -> None:
        value = said.get("params", {})
        if said["method"] == "Runtime.exceptionThrown":
            self.errors.append(str(value["exceptionDetails"].get("exception", value["exceptionDetails"])))
        if said["method"] == "Log.entryAdded" and value["entry"]["level"] == "error":
            self.errors.append(f"{value['entry']['text']} {value['entry'].get('url', '')}")

    def open(self, url: str, width: int, height: int = 900) -> None:
        self.call("Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=1, mobile=width < 600)
        self.call("Page.navigate", url=url)

    def value(self, expression: str) -> Any:
        found = self.call("Runtime.evaluate", expression=expression, returnByValue=True, awaitPromise=True)
        assert "exceptionDetails" not in found, found["exceptionDetails"]
        return found["result"].get("value")

    def until(self, expression: str, seconds: float = 30.0) -> Any:
        deadline = time.monotonic() + seconds
        while not (found := self.value(f"(() => {{ try {{ return {expression}; }} catch {{ return null; }} }})()")):
            assert time.monotonic() < deadline, f"never true: {expression}; the page shows: {self.value('document.body.innerText')[:2000]}"
            time.sleep(0.1)
        return found

    def press(self, key: str, shift: bool = False) -> None:
        codes = {"Tab": (9, ""), "Enter": (13, "\r"), "Escape": (27, ""), " ": (32, " ")}
        code, text = codes[key]
        for kind in ("keyDown", "keyUp"):
            more = {"text": text} if text and kind == "keyDown" else {}
            self.call("Input.dispatchKeyEvent", type=kind, key=key, code=key, windowsVirtualKeyCode=code, modifiers=8 * shift, **more)

    def type(self, text: str) -> None:
        self.call("Input.insertText", text=text)

    def tab_to(self, label: str, most: int = 60) -> None:
        """Move by the Tab key alone to what a screen reader calls ``label``."""
        for _ in range(most):
            self.press("Tab")
            if self.value("document.activeElement.getAttribute('aria-label') || document.activeElement.textContent.trim() || document.activeElement.name") == label:
                return
        raise AssertionError(f"no '{label}' within {most} presses of Tab; the page shows: {self.value('document.body.innerText')[:2000]}")

    def picture(self, path: Path) -> None:
        size = self.call("Page.getLayoutMetrics")["cssContentSize"]
        clip = {"x": 0, "y": 0, "width": size["width"], "height": min(size["height"], 4000), "scale": 1}
        path.write_bytes(base64.b64decode(self.call("Page.captureScreenshot", format="png", clip=clip, captureBeyondViewport=True)["data"]))

    def unnamed(self) -> list[str]:
        """Return the roles of what can be operated, or is a picture or table, and has no name for a screen reader."""
        roles = ("button", "link", "textbox", "spinbutton", "combobox", "image", "table", "dialog", "region", "navigation")
        nodes = self.call("Accessibility.getFullAXTree")["nodes"]
        return [n["role"]["value"] for n in nodes if not n.get("ignored") and n.get("role", {}).get("value") in roles and not n.get("name", {}).get("value")]
