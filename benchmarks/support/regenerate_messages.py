"""Regenerate the messages from ``afdsvc.proto`` with ``python benchmarks/support/regenerate_messages.py`` (needs grpcio-tools)."""

from __future__ import annotations

import sys
from pathlib import Path

HERE = Path(__file__).resolve().parents[2] / "afdsvc" / "wire"


def run_protoc() -> int:
    """Run protoc in `afdsvc/wire`; returns its exit code."""
    import grpc_tools
    from grpc_tools import protoc

    well_known = Path(grpc_tools.__file__).parent / "_proto"
    arguments = ["protoc", f"-I{HERE}", f"-I{well_known}", f"--python_out={HERE}", f"--pyi_out={HERE}"]
    code = int(protoc.main([*arguments, str(HERE / "afdsvc.proto")]))
    stub = HERE / "afdsvc_pb2.pyi"
    if code == 0:
        stub.write_text("# ruff: noqa\n# mypy: ignore-errors\n" + stub.read_text())
    return code


if __name__ == "__main__":
    sys.exit(run_protoc())
