"""The picture in characters shows both curves where they are."""

import numpy as np

from afdsvc.present.text_plot import HEIGHT, WIDTH, close_up, text_plot


def test_curves_are_where_their_values_are():
    rising = np.linspace(-1, 1, 720)
    rows = [row[10:].ljust(WIDTH) for row in text_plot(rising, -rising)]
    assert len(rows) == HEIGHT
    assert (rows[0][-1], rows[0][0], rows[-1][0], rows[-1][-1]) == ("·", "+", "·", "+")
    assert "#" in rows[HEIGHT // 2]


def test_missing_readings_leave_a_hole():
    measured = np.where(np.arange(720) < 360, np.nan, 1.0)
    row = text_plot(measured, np.zeros(720))[0][10:]
    assert row.strip() == "·" * (WIDTH // 2)


def test_the_close_up_is_where_they_differ():
    simulated = np.zeros(2000)
    measured = np.where(np.abs(np.arange(2000) - 1500) < 50, 1.0, 0.0)
    part = close_up(measured, simulated)
    assert part.start <= 1450
    assert part.stop >= 1549
