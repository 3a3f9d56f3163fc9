"""What people read in a terminal: nothing of a name, path or sentence is taken for a style."""

from __future__ import annotations

from afdsvc.present import terminal


def test_brackets_and_colons_are_printed_as_they_are():
    row = {"name": "mine", "asked": "J_K takes [y, alpha] :warning:", "failure": "found [bold], wanted [/]"}
    with terminal.OUT.capture() as seen:
        terminal.check_table([row, row | {"failure": ""}])
        terminal.plugin_table([{"family": "[red]", "name": "a[1]", "summary": "", "plugin": "p"}], {"b[2]": "no [blue] module"})
    words = " ".join(seen.get().split())
    for text in ("[y, alpha] :warning:", "[bold]", "[/]", "[red]", "a[1]", "b[2] could not be loaded: no [blue] module"):
        assert text in words
