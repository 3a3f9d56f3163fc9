"""Makes the pictures of the README and the how-tos from nothing: ``PYTHONPATH=. python docs/pictures/make.py [review compared history web explain]``.

Runs a demonstration, reviews it, explains the tutorial's slide, and takes pictures of Rerun (headless; needs a Vulkan driver such as Debian's
mesa-vulkan-drivers) and of the web page (needs chromium). About two minutes. Look at every picture before it is committed.
"""

from __future__ import annotations

import os
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from afdsvc.api.evidence import Evidence, Severity
from afdsvc.app.demo import rig_process, run_demo
from afdsvc.app.demo_site import DemoOptions, free_port, site_text
from afdsvc.app.review import fault_planes
from afdsvc.files.recording.recorder import Recorder, RecordingSettings
from afdsvc.present.rerun import review_history, review_recordings
from afdsvc.wire.codec import encode
from afdsvc.wire.messages import Finding
from benchmarks.support.browser import Browser

HERE = Path(__file__).parent
SHIPPED = HERE.parents[1] / "recordings" / "shipped"
LAVAPIPE = Path("/usr/share/vulkan/icd.d/lvp_icd.x86_64.json")


@contextmanager
def viewer(size: tuple[int, int]) -> Iterator[int]:
    """Run the viewer without a screen; yields its port."""
    import rerun_cli

    with socket.socket() as s:
        s.bind(("127.0.0.1", 0))
        port = int(s.getsockname()[1])
    environment = {**os.environ, "RERUN_APP_ONLY": "true", "WGPU_BACKEND": "vulkan", "XDG_RUNTIME_DIR": tempfile.gettempdir()}
    if LAVAPIPE.exists():
        environment.setdefault("VK_ICD_FILENAMES", str(LAVAPIPE))
    command = [str(Path(rerun_cli.__file__).parent / "rerun"), "--headless", "--bind", "127.0.0.1", "--port", str(port)]
    command += ["--hide-welcome-screen", "--window-size", f"{size[0]}x{size[1]}"]
    process = subprocess.Popen(command, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        yield port
    finally:
        process.terminate()
        process.wait(10)


def shot(file: Path, name: str, size: tuple[int, int] = (1600, 1000)) -> None:
    """Take a picture of a Rerun file with the cursor at its end, once two pictures in a row are equal."""
    from rerun.experimental import ViewerClient

    with viewer(size) as port:
        client = _connected(ViewerClient, port)
        client.open([str(file)])
        state = _loaded(client)
        recording = next(r for r in state.recordings if r.timelines)
        if recording.location:
            client.set_location(recording.location)
        line = next(t for t in recording.timelines if t.name == (recording.current_timeline or recording.timelines[0].name))
        at = {"duration": np.timedelta64(int(line.end), "ns")} if line.time_type == "duration" else {"timestamp": np.datetime64(int(line.end), "ns")}
        client.set_time(line.name, play_state="paused", recording=recording.store_id, **at)
        time.sleep(6)  # notices of the start fade
        before, picture = b"", client.take_screenshot()
        for _ in range(40):
            if picture == before:
                break
            time.sleep(0.7)
            before, picture = picture, client.take_screenshot()
    (HERE / name).write_bytes(picture)
    print(HERE / name)


def _connected(client: type, port: int) -> object:
    for _ in range(300):
        try:
            socket.create_connection(("127.0.0.1", port), 0.5).close()
            return client.connect(f"rerun+http://127.0.0.1:{port}/proxy")  # type: ignore[attr-defined]
        except OSError:
            time.sleep(0.1)
    raise SystemExit("the viewer did not start; is there a Vulkan driver?")


def _loaded(client: object) -> object:
    for _ in range(180):
        state = client.get_state()  # type: ignore[attr-defined]
        if not state.loading and any(t.end is not None for r in state.recordings for t in r.timelines):
            return state
        time.sleep(0.25)
    raise SystemExit("the viewer loaded nothing")


def demonstration(folder: Path) -> tuple[Path, Path]:
    """Return recording and review of the demo: a bearing that loses half the gain of an actuator after 12 s."""
    found = run_demo(DemoOptions(out=folder), lambda seconds, hub: None)
    return Path(found["recording"]), Path(found["rerun"])


def months(folder: Path) -> list[Path]:
    """Return recordings of decisions only: four a day for four months, an actuator that slowly wears."""
    rng, made = np.random.default_rng(3), []
    for day in range(120):
        recorder = Recorder(RecordingSettings(folder / f"day{day:03d}.mcap"))
        for quarter in range(4):
            true = -0.002 * max(day + quarter / 4 - 40, 0)
            seen, found = true + 0.004 * rng.normal(), true < -0.006
            severity = Severity(seen, 0.004) if found else None
            evidence = Evidence(
                "matched_filter", "bearing-1", 0, 0.0, -seen / 0.0012, 3.5, found, burst=f"b{day}-{quarter}",
                fault="horizontal_actuator" if found else None, severity=severity,
            )  # fmt: skip
            finding = Finding(evidence, f"s{day}", (1_770_000_000 + day * 86400 + quarter * 21600) * 10**9)
            recorder.finding(encode(finding), finding)
        recorder.close()
        made.append(recorder.path)
    return made


def web(folder: Path) -> None:
    """Take pictures of the page of a service with one machine that runs with a fault and one that is absent."""
    port, page = free_port(), free_port()
    text = site_text(DemoOptions(faults=(("horizontal_actuator", -0.5, 1.0),), out=folder / "web"), port).replace('rerun = "file"', 'rerun = "off"')
    site = folder / "web.toml"
    site.write_text(f'{text}\n[[machines]]\nid = "spindle"\nplant = "gas_bearing"\n\n[web]\nlisten = "127.0.0.1:{page}"\n')
    service = subprocess.Popen([sys.executable, "-m", "afdsvc", "serve", str(site)], stderr=subprocess.DEVNULL)
    browser = Browser(folder / "browser")
    try:
        with rig_process(site, "bearing", 180.0):
            while not (link := subprocess.run([sys.executable, "-m", "afdsvc", "console", "--site", str(site)], capture_output=True, text=True).stdout.strip()):
                if service.poll() is not None:
                    raise SystemExit("the service did not start")
            for name, width in (("web.png", 1000), ("web-phone.png", 400)):
                browser.open(link if width == 1000 else f"http://127.0.0.1:{page}/", width)
                browser.until("document.body.innerText.includes('signed in') && document.body.innerText.includes('The last decisions')", 90.0)
                time.sleep(10 if width == 1000 else 1)  # for some decisions more
                browser.picture(HERE / name)
                print(HERE / name)
    finally:
        browser.close()
        service.terminate()
        service.wait(20)


def explained(folder: Path) -> None:
    """Take pictures of the report and of the Rerun file of the tutorial "why the model is wrong"."""
    subprocess.run([sys.executable, str(HERE.parents[1] / "examples" / "explain_friction.py")], cwd=folder, check=True)
    command = "explain slide.toml weak.csv strong.csv medium.csv --holdout kept.csv --rrd slide.rrd"
    subprocess.run([sys.executable, "-m", "afdsvc", *command.split()], cwd=folder, check=True)
    explained_pictures(folder)


def explained_pictures(folder: Path) -> None:
    browser = Browser(folder / "browser")
    try:
        browser.open((folder / "slide.explained" / "report.html").as_uri(), 800)
        browser.until("document.readyState === 'complete'")
        browser.picture(HERE / "explain-report.png")
    finally:
        browser.close()
    shot(folder / "slide.rrd", "explain-rerun.png", (1200, 750))


def main() -> None:
    """Make what is asked for, or everything."""
    asked = set(sys.argv[1:]) or {"review", "compared", "history", "web", "explain"}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        if asked & {"review", "compared"}:
            recording, review = demonstration(folder)
        if "review" in asked:
            shot(review, "review.png")
        if "compared" in asked:
            others = [SHIPPED / f"gas_bearing_{kind}.mcap" for kind in ("vertical_sensor", "nominal")]
            shot(review_recordings([recording, *others], folder / "compared.rrd", planes=fault_planes), "review-compared.png")
        if "history" in asked:
            (folder / "months").mkdir()
            shot(review_history(months(folder / "months"), folder / "history.rrd"), "review-history.png", (1600, 600))
        if "web" in asked:
            web(folder)
        if "explain" in asked:
            explained(folder)


if __name__ == "__main__":
    main()
