"""Follows tutorials as they are printed and puts today's lines in the place of those that changed: ``PYTHONPATH=. python docs/run_tutorials.py [PAGE...]``.

``tests/system/test_tutorials.py`` only compares. How a page is read, fence by fence:

- ``toml`` and ``python``: the file that the paragraph before ends with, in backticks before a colon. Where it is there already it is compared, unless
  the page says what it "becomes".
- ``sh``: commands, in a folder that looks like a clone. Virtual environments and ``pip install`` are taken as done. What is commented as running in a
  terminal runs until the recordings are opened; meanwhile a command is repeated until it prints what the page shows.
- ``text``: lines that were printed before, or stand in the file that the paragraph before ends with. ``...`` stands for any words of a line.

Numbers agree within 2 %. Where a service ran they depend on the clock: any number will do, but in a line that begins with ``verdict``, within two.
"""

from __future__ import annotations

import difflib
import math
import os
import re
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

ROOT = Path(__file__).parents[1]
PAGES = sorted((ROOT / "docs" / "tutorial").glob("*.md"))
FENCE = re.compile(r"^```(\w+)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
DONE = re.compile(r"(python3 -m venv|\. |pip install (?!-e)|mkdir )")
OPENING = re.compile(r"afdsvc (diagnose|review)")
PATIENCE = 120.0  # s, for what a page shows while a service runs


class Follower:
    """A page followed in a folder; ``changed`` holds the printed lines that did not come, each with the most similar one that did."""

    def __init__(self, page: Path, folder: Path) -> None:
        self.page, self.folder, self.here = page, folder, folder
        self.said: list[str] = []
        self.changed: dict[str, str] = {}
        self.running: list[subprocess.Popen[str]] = []
        self.live = False
        paths = os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])
        self.environment = {**os.environ, "PATH": paths, "COLUMNS": "100", "PYTHONPATH": os.environ.get("PYTHONPATH", "")}
        for name in ("examples", "recordings/shipped"):
            (folder / name).parent.mkdir(exist_ok=True)
            (folder / name).symlink_to(ROOT / name)

    def follow(self) -> dict[str, str]:
        text = self.page.read_text(encoding="utf-8")
        fences, end = list(FENCE.finditer(text)), 0
        try:
            for fence, after in zip(fences, [*fences[1:], None], strict=True):
                paragraph = text[end : fence.start()].strip().rpartition("\n\n")[2]
                self._fence(fence[1], fence[2], paragraph, after[2] if after and after[1] == "text" else "")
                end = fence.end()
        finally:
            self.stop()
        return self.changed

    def _fence(self, kind: str, text: str, paragraph: str, shown: str) -> None:
        named = re.findall(r"`([\w./-]+\.\w+)`", paragraph)
        file = self.here / named[-1] if named and paragraph.rstrip().endswith((":", "begins")) else None
        if kind == "sh":
            for line in text.splitlines():
                self._command(line, shown)
        elif kind == "text" or (file and file.exists() and "becomes" not in paragraph):
            self._compare(text, self.said + (file.read_text(encoding="utf-8").splitlines() if file else []))
        elif file:
            file.write_text(text, encoding="utf-8")

    def _command(self, line: str, shown: str) -> None:
        command, _, comment = (part.strip() for part in line.partition(" #"))
        for part in command.split(" && "):
            if part.startswith("cd "):
                self.here = (self.here / part.removeprefix("cd ")).resolve()
                self.here.mkdir(exist_ok=True)
            elif part.startswith("pip install -e "):
                self._installed(part.split("'")[1].partition("[")[0])
            elif "terminal" in comment:
                self._beside(part)
            elif part and not DONE.match(part):
                self._run(part, shown)

    def _installed(self, name: str) -> None:
        """Make a plugin's entry point known as pip would."""
        package = self.here / name
        about = package / f"{name}-0.1.0.dist-info"
        about.mkdir()
        (about / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 0.1.0\n")
        (about / "entry_points.txt").write_text(f"[afdsvc]\n{name} = {name}\n")
        self.environment["PYTHONPATH"] = os.pathsep.join(filter(None, [str(package), self.environment["PYTHONPATH"]]))

    def _beside(self, command: str) -> None:
        """Start what keeps running; a service is waited for until it serves."""
        self.live = True
        said = self.here / f"terminal{len(self.running)}.txt"
        with said.open("w") as log:
            process = subprocess.Popen(["bash", "-c", f"exec {command}"], cwd=self.here, env=self.environment, stdout=log, stderr=subprocess.STDOUT)
        self.running.append(process)
        while "serve " in command and "serving" not in said.read_text():
            if process.poll() is not None:
                raise RuntimeError(f"{command}: {said.read_text()}")
            time.sleep(0.1)

    def _run(self, command: str, shown: str) -> None:
        if OPENING.match(command):
            self.stop()
        until, pause = time.monotonic() + PATIENCE, 2.0
        while True:
            done = subprocess.run(["bash", "-c", command], cwd=self.here, env=self.environment, capture_output=True, text=True)
            lines = done.stdout.splitlines()
            if done.returncode == 0 and (not self.running or all(self._came(line, lines) for line in shown.splitlines() if line.strip())):
                break
            if not self.running or time.monotonic() > until:
                raise RuntimeError(f"{command}\n{done.stdout}\n{done.stderr}")
            time.sleep(pause)
            pause = min(1.5 * pause, 4.0)  # s; a command costs most of a second of a processor that the service needs
        self.said += lines

    def _came(self, printed: str, said: list[str]) -> bool:
        near = partial(_near, relative=0.0 if self.live else 0.02, absolute=0.0 if not self.live else 2.0 if printed.startswith("verdict") else math.inf)
        return any(alike(printed, line, near) for line in said)

    def _compare(self, text: str, said: list[str]) -> None:
        for line in text.splitlines():
            if line.strip(" ─") and not self._came(line, said):
                self.changed[line] = next(iter(difflib.get_close_matches(line.partition("...")[0], said, 1, 0.0)), "")

    def stop(self) -> None:
        """End what runs as Ctrl-C does, the last first."""
        while self.running:
            process = self.running.pop()
            if process.poll():
                raise RuntimeError(f"{process.args} ended with {process.returncode}")
            process.send_signal(signal.SIGINT)
            process.wait(PATIENCE)


def alike(printed: str, found: str, near: Callable[[str, str], bool]) -> bool:
    """Return whether a printed line is the line found, words equal or ``near``; dots stand for any words."""
    words, others = printed.split(), found.split()
    if "..." in words:
        at = words.index("...")
        before, after = words[:at], words[at + 1 :]
        if len(others) < len(before) + len(after):
            return False
        words, others = before + after, others[:at] + others[len(others) - len(after) :]
    return len(words) == len(others) and all(a == b or near(a, b) for a, b in zip(words, others, strict=True))


def _near(a: str, b: str, relative: float, absolute: float) -> bool:
    try:
        return math.isclose(*(float(word.strip("%;(),[]{}")) for word in (a, b)), rel_tol=relative, abs_tol=absolute)
    except ValueError:
        return False


def shortened(printed: str, found: str) -> str:
    """Return the line found with the dots of the one that is printed."""
    if "..." not in printed:
        return found.rstrip()
    kept = len(printed.partition("...")[0].split())
    return "".join(re.findall(r"\s*\S+", found)[:kept]) + " ..."


if __name__ == "__main__":
    for page in [Path(p).resolve() for p in sys.argv[1:]] or PAGES:
        with tempfile.TemporaryDirectory() as folder:
            changed = Follower(page, Path(folder)).follow()
        text = page.read_text(encoding="utf-8")
        for printed, found in changed.items():
            print(f"{page.name}\n- {printed}\n+ {found}")
            text = text.replace(f"{printed}\n", f"{shortened(printed, found)}\n")
        page.write_text(text, encoding="utf-8")
