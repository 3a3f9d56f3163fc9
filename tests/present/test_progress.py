"""What a command that takes long says on stderr while it runs."""

import io

from rich.console import Console

from afdsvc.present import progress


def test_a_log_gets_a_line_every_ten_seconds(monkeypatch, capsys):
    clock = iter([0.0, 4.0, 10.5, 10.5, 12.0, 20.6, 20.6])
    monkeypatch.setattr(progress.time, "monotonic", lambda: next(clock))
    with progress.progress("explaining", 1.0) as tell:
        tell(0.1, "checking")
        tell(0.2, "round 1 [a], fitting 3 of 9")
        tell(0.3, "round 1, fitting 4 of 9")
        tell(0.4)
    assert capsys.readouterr().err == "explaining: round 1 [a], fitting 3 of 9 (10 s)\nexplaining (21 s)\n"


def test_a_terminal_gets_a_bar_that_goes_away(monkeypatch):
    shown = io.StringIO()
    monkeypatch.setattr(progress, "ERR", Console(file=shown, force_terminal=True, markup=False, width=80))
    with progress.progress("explaining", 1.0) as tell:
        tell(0.5, "round 1")
    assert "explaining: round 1" in shown.getvalue()
    assert "\n\x1b[1A\x1b[2K" in shown.getvalue() or shown.getvalue().endswith("\x1b[2K")
