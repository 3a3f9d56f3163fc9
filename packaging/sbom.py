"""The bill of materials (CycloneDX 1.5, JSON) of an installed afdsvc, from the metadata of what is installed; no network.

    python packaging/sbom.py --extra tls --extra metrics > sbom.json

A component is every installed distribution that afdsvc needs, directly or not, with its version, licence, and SHA-256 of its list of files (RECORD,
which holds the hash of every file). Two runs in one environment give the same bytes.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import re
import sys
from importlib import metadata

NAME = "afdsvc"


def normal(name: str) -> str:
    """Return a distribution's name as registries compare it."""
    return re.sub(r"[-_.]+", "-", name).lower()


def needed(distribution: metadata.Distribution, extras: set[str]) -> list[tuple[str, set[str]]]:
    """Return what a distribution requires with these extras, as (name, its extras); requirements of other platforms are not installed."""
    found = []
    for requirement in distribution.requires or ():
        wanted, _, marker = requirement.partition(";")
        asked = re.search(r"extra\s*==\s*['\"]([^'\"]+)['\"]", marker)
        if asked is None or normal(asked[1]) in extras:
            name, inner = re.match(r"\s*([A-Za-z0-9._-]+)\s*(?:\[([^\]]*)\])?", wanted).groups()
            found.append((normal(name), {normal(e.strip()) for e in (inner or "").split(",") if e.strip()}))
    return found


def closure(extras: set[str]) -> tuple[dict[str, metadata.Distribution], dict[str, set[str]]]:
    """Return the installed distributions that afdsvc needs, itself among them, and which needs which, by name."""
    installed = {normal(d.metadata["Name"]): d for d in metadata.distributions()}
    if NAME not in installed:
        sys.exit("afdsvc is not installed in this environment")
    edges: dict[str, set[str]] = {}
    done: dict[str, set[str]] = {}
    waiting = [(NAME, extras)]
    while waiting:
        name, with_extras = waiting.pop()
        if name in done and with_extras <= done[name]:
            continue
        done[name] = done.get(name, set()) | with_extras
        inner = [(n, e) for n, e in needed(installed[name], done[name]) if n in installed]
        edges[name] = {n for n, _ in inner if n != name}
        waiting += inner
    return {name: installed[name] for name in sorted(edges)}, edges


def component(name: str, distribution: metadata.Distribution) -> dict:
    """Return one component."""
    told = distribution.metadata
    licence = told.get("License-Expression") or next(
        (c.rpartition(" :: ")[2] for c in told.get_all("Classifier") or () if c.startswith("License :: ")), (told.get("License") or "").partition("\n")[0]
    )
    record = distribution.read_text("RECORD")
    purl = f"pkg:pypi/{name}@{distribution.version}"
    return {
        "type": "application" if name == NAME else "library", "bom-ref": purl, "name": name, "version": distribution.version, "purl": purl,
        **({"licenses": [{"license": {"name": licence}}]} if licence else {}),
        **({"hashes": [{"alg": "SHA-256", "content": hashlib.sha256(record.encode()).hexdigest()}]} if record else {}),
    }  # fmt: skip


def bill(extras: set[str]) -> dict:
    """Return the bill of materials."""
    found, edges = closure(extras)
    components = {name: component(name, d) for name, d in found.items()}
    ref = {name: c["bom-ref"] for name, c in components.items()}
    return {
        "bomFormat": "CycloneDX", "specVersion": "1.5", "version": 1, "metadata": {"component": components.pop(NAME)},
        "components": list(components.values()),
        "dependencies": [{"ref": ref[name], "dependsOn": sorted(ref[n] for n in edges[name])} for name in ref],
    }  # fmt: skip


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--extra", action="append", default=[], help="an extra of afdsvc that is installed, such as tls")
    print(json.dumps(bill({normal(e) for e in parser.parse_args().extra}), indent=1))
