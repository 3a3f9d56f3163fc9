"""The bill of materials names what is installed, and nothing that afdsvc does not need."""

from __future__ import annotations

import json
import subprocess
import sys
from importlib.metadata import version
from pathlib import Path

SCRIPT = Path(__file__).parents[2] / "packaging" / "sbom.py"


def test_the_bill_of_materials_holds_everything_that_is_needed_with_its_version():
    plain, again, with_tls = (
        subprocess.run([sys.executable, str(SCRIPT), *extra], stdout=subprocess.PIPE, check=True).stdout for extra in ((), (), ("--extra", "tls"))
    )
    assert plain == again
    bill = json.loads(with_tls)
    found = {c["name"]: c for c in bill["components"]}
    for name in ("numpy", "scipy", "numba", "llvmlite", "eclipse-zenoh", "pydantic-core", "cryptography"):
        assert found[name]["version"] == version(name)
        assert found[name]["purl"] == f"pkg:pypi/{name}@{version(name)}"
        assert len(found[name]["hashes"][0]["content"]) == 64
        assert found[name]["licenses"]
    assert "cryptography" not in {c["name"] for c in json.loads(plain)["components"]}
    assert "pytest" not in found
    refs = {c["bom-ref"] for c in [*bill["components"], bill["metadata"]["component"]]}
    assert {d["ref"] for d in bill["dependencies"]} == refs
    assert {ref for d in bill["dependencies"] for ref in d["dependsOn"]} <= refs
