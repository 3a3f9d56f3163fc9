"""The words of the report of ``explain``."""

from __future__ import annotations

from afdsvc.present.html.explain_page import _axes, _legend, _percent, _verdict_sentence


def test_the_answer_names_what_the_recordings_do_not_distinguish():
    names = (("coulomb_friction", "state:speed", 1), ("transport_delay", "input:voltage", 2), ("actuator_lag", "input:voltage", 2), ("sensor_lag", "output:speed", 2))
    named = [{"physics": physics, "site": site, "effect": effect, "parameters": {}} for physics, site, effect in names]
    assert _verdict_sentence({"verdict": "omitted_physics", "named": named}) == (
        "The model leaves out physics that the recordings show: coulomb friction (force on speed) and "
        "transport delay or actuator lag (input voltage) or sensor lag (sensor speed)."
    )


def test_a_parameter_that_changed_has_its_own_name():
    named = [{"physics": "parameter_change", "site": "parameter:mass", "effect": 1, "parameters": {"mass": {}}}]
    assert "mass (" in _verdict_sentence({"verdict": "parameter_change", "named": named})


def test_a_share_of_nothing_has_no_sign():
    assert _percent(-1e-5) == "0.0 %"


def test_a_legend_stands_above_its_axes_and_hides_no_curve():
    figure, (ax,) = _axes(1, 1, 1.7)
    ax.plot([0, 1], [0, 1], label="measured")
    _legend(ax)
    figure.draw_without_rendering()
    assert ax.get_legend().get_window_extent().y0 >= ax.get_window_extent().y1 - 1
