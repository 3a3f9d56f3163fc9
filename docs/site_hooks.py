"""Files that pages link to outside this folder, put on the site as they are: examples and packaging (``hooks`` of mkdocs.yml)."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

from mkdocs.structure.files import File, Files, InclusionLevel

ROOT = Path(__file__).parents[1]
OUTSIDE = re.compile(r"\]\(\.\./\.\./((?:examples|packaging)[^)#\s]*)\)")


def on_files(files: Files, config: Any) -> Files:
    """Add the files that are linked to."""
    pages = [p.read_text(encoding="utf-8") for p in Path(config.docs_dir).rglob("*.md")]
    for name in sorted({n for text in pages for n in OUTSIDE.findall(text)}):
        files.append(File.generated(config, name, content=(ROOT / name).read_text(encoding="utf-8"), inclusion=InclusionLevel.INCLUDED))
    return files


def on_page_markdown(markdown: str, **_: Any) -> str:
    """Point the links at them."""
    return OUTSIDE.sub(r"](../\1)", markdown)
