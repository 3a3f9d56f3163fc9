"""Regenerate the messages from ``afdsvc.proto`` with ``python -m afdsvc.wire.regenerate`` (needs grpcio-tools)."""

from __future__ import annotations

import sys
from pathlib import Path

HERE = Path(__file__).parent


def run_protoc() -> int:
    """Run protoc beside this file; returns its exit code."""
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
