"""The layout in the real viewer: every view draws, none reports an error. Needs a Vulkan driver (software will do)."""

import os
import socket
import subprocess
import time

import numpy as np
import pytest

from afdsvc.present.rerun.log import ReviewLog

SOFTWARE = "/usr/share/vulkan/icd.d/lvp_icd.x86_64.json"


def free_port() -> int:
    with socket.socket() as s:
        s.bind(("127.0.0.1", 0))
        return s.getsockname()[1]


@pytest.fixture
def viewer(tmp_path):
    """Yield a client of a viewer without window; skipped where it cannot draw."""
    import rerun_cli
    from rerun.experimental import ViewerClient

    if not os.path.exists(SOFTWARE):
        pytest.skip("no software Vulkan driver (mesa-vulkan-drivers)")
    port = free_port()
    command = [os.path.join(os.path.dirname(rerun_cli.__file__), "rerun"), "--headless", "--bind", "127.0.0.1"]
    env = os.environ | {
        "RERUN_APP_ONLY": "true", "WGPU_BACKEND": "vulkan", "VK_ICD_FILENAMES": SOFTWARE,
        "XDG_RUNTIME_DIR": str(tmp_path), "XDG_CONFIG_HOME": str(tmp_path), "XDG_DATA_HOME": str(tmp_path),
    }  # fmt: skip
    subprocess.run([command[0], "analytics", "disable"], env=env, check=True, capture_output=True)
    size = ["--port", str(port), "--hide-welcome-screen", "--window-size", "1400x900"]
    process = subprocess.Popen([*command, *size], env=env, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        wait_for(lambda: listens(port))
        yield ViewerClient.connect(f"rerun+http://127.0.0.1:{port}/proxy")
    finally:
        process.terminate()
        process.wait(10)


def listens(port: int) -> bool:
    with socket.socket() as s:
        return s.connect_ex(("127.0.0.1", port)) == 0


def wait_for(condition, seconds: float = 40.0):
    deadline = time.monotonic() + seconds
    while not (found := condition()):
        assert time.monotonic() < deadline, "waited in vain"
        time.sleep(0.2)
    return found


@pytest.mark.long
@pytest.mark.filterwarnings("ignore")
def test_every_view_draws(tmp_path, blocks, finding, viewer):
    log = ReviewLog(tmp_path / "a.rrd")
    for machine in ("m1", "m2"):
        for block in blocks(60, bursts=(10, 11, 30, 31), machine=machine):
            log.block(block)
    for seconds, statistic in ((0.6, 2.0), (1.6, 41.0)):
        log.finding(finding(seconds, statistic))
    log.close()
    viewer.open([str(tmp_path / "a.rrd")])
    state = wait_for(lambda: (s := viewer.get_state()) and not s.loading and len(s.views) >= 10 and s)
    names = {view.name for view in state.views}
    assert names >= {
        "output y: h [um]", "output y: v [um]", "input u: h [um]", "excitation alpha: h [um]",
        "residual beta, before whitening: v [um]", "matched_filter: statistic, threshold in red",
        "bursts and decisions", "events",
    }  # fmt: skip
    time.sleep(5.0)  # the viewer shows greetings first
    assert [(v.name, r.summary) for v in viewer.get_state().views for r in v.reports if r.severity == "error"] == []
    shot = np.frombuffer(viewer.take_screenshot(None), dtype=np.uint8)
    assert len(shot) > 50_000  # an empty window compresses to a tenth of that
