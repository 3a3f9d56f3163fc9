"""Every link between the project's pages leads somewhere, and every page of the site's menu is there."""

from __future__ import annotations

import re
from pathlib import Path, PurePath

import afdsvc

ROOT = Path(afdsvc.__file__).parent.parent
PAGES = [*sorted(ROOT.glob("*.md")), *sorted((ROOT / "docs").rglob("*.md"))]


def anchors(page: Path) -> set[str]:
    """Return what the headings of a page are called in links: as on the site and on forges, lower case, words joined by hyphens."""
    text = re.sub(r"^```.*?^```", "", page.read_text(encoding="utf-8"), flags=re.MULTILINE | re.DOTALL)
    heads = re.findall(r"^#+ +(.*?) *$", re.sub(r"\]\([^)]*\)", "", text), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", head).strip().lower().replace(" ", "-") for head in heads} | set(re.findall(r'<a (?:id|name)="([^"]+)"', text))


def test_links_lead_somewhere():
    """To a file that is there and, where they name one, to a heading of it."""
    broken = []
    for page in PAGES:
        for target, _, anchor in re.findall(r"\]\(([^)#\s]*)(#?)([^)\s]*)\)", page.read_text(encoding="utf-8")):
            file = page.parent / target if target else page
            if target.startswith(("http:", "https:", "mailto:")):
                continue
            if not file.exists() or (anchor and file.suffix == ".md" and anchor not in anchors(file)):
                broken.append(f"{page.relative_to(ROOT)}: {target}#{anchor}")
    assert broken == []


def test_links_that_leave_the_documentation_lead_to_files_that_the_site_copies():
    """See docs/site_hooks.py."""
    left = [
        target
        for page in (ROOT / "docs").rglob("*.md")
        for target in re.findall(r"\]\((\.\.[^)#\s]*)", page.read_text(encoding="utf-8"))
        if not (page.parent / target).resolve().is_relative_to(ROOT / "docs")
    ]
    assert len(left) > 3
    assert [t for t in left if not (re.match(r"\.\./\.\./(examples|packaging)/", t) and (ROOT / "docs" / "how-to" / t).is_file())] == []


def test_files_that_pages_link_to_are_on_the_site():
    """What is excluded there is no aim of a link: tables and the notebook are."""
    excluded = re.search(r"^exclude_docs: \|\n((?:  .*\n)+)", (ROOT / "mkdocs.yml").read_text(encoding="utf-8"), re.MULTILINE)
    assert excluded
    patterns = excluded[1].split()
    linked = {t for page in PAGES for t in re.findall(r"\]\(([^)#\s:]+)", page.read_text(encoding="utf-8")) if page.is_relative_to(ROOT / "docs")}
    assert [t for t in sorted(linked) if not t.startswith("../../") and any(PurePath(t).match(pattern) for pattern in patterns)] == []


def test_the_menu_of_the_site_names_pages_that_are_there():
    """And every page is in the menu."""
    pages = re.findall(r": ([\w/.-]+\.md)$", (ROOT / "mkdocs.yml").read_text(encoding="utf-8"), re.MULTILINE)
    assert len(pages) > 10
    assert [p for p in pages if not (ROOT / "docs" / p).exists()] == []
    assert sorted(pages) == sorted(str(p.relative_to(ROOT / "docs")) for p in (ROOT / "docs").rglob("*.md"))
