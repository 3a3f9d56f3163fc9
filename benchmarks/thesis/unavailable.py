"""Figures and tables that cannot be remade, each with its reason."""

from __future__ import annotations

from benchmarks.thesis.figure import Figure

DRAWING = "a drawing; nothing is computed"
PHOTO = "a photograph of the authors' rig"
RIG = "measured on the authors' rig; the data are not published"
EXAMPLE = "an example whose system is not stated; `afdsvc design` shows the same curves for any machine"

_REASONS = {
    DRAWING: {
        **{f"figure-{n}": what for n, what in {
            "1.1": "closed-loop to open-loop identification", "1.2": "a bank of plants", "2.1": "the YJBK scheme", "2.2": "the augmented controller", "2.3": "S and the plant", "2.4": "S and Q",
            "2.5": "the augmented plant", "2.6": "S(theta) as a star product", "2.7": "the observer scheme", "3.2": "schematic of the bearing", "3.3": "side view of the rig", "3.4": "model of the bearing",
            "4.1": "S and theta", "4.2": "the closed loop", "4.3": "G(theta)", "4.4": "generation of signals", "4.6": "the Hansen scheme", "4.7": "the modified Hansen scheme", "4.8": "both schemes compared",
            "5.1": "the closed loop", "5.2": "active diagnosis", "5.3": "the same with noise", "5.5": "the same with a test", }.items()},
        "table-5.1": "right and wrong decisions",
        **{f"p1-0.{n}": what for n, what in (("1", "the closed loop"), ("2", "all stabilising controllers"), ("3", "section of the turboexpander"), ("4", "elements of the shaft"))},
        **{f"p2-0.{n}": what for n, what in (("1", "the closed loop"), ("2", "the Hansen scheme"), ("3", "the controller"), ("4", "LFT of G(S)"), ("5", "G(S) and K(Q)"), ("6", "the general scheme"), ("7", "the simulation"), ("12", "the rig as blocks"))},
        **{f"p3-0.{n}": what for n, what in (("1", "the closed loop"), ("2", "factors of the plant"), ("3", "factors of the controller"), ("4", "LFT of the faults"), ("6", "the simulation"))},
        **{f"p4-0.{n}": what for n, what in (("1", "open loop"), ("2", "closed loop"), ("3", "Youla form of the controller"), ("4", "of the plant"), ("5", "S and Q"), ("6", "the controller in use"), ("9", "flow chart"))},
        **{f"p5-0.{n}": what for n, what in (("1", "section of the bearing"), ("4", "the set-up"), ("8", "the set-up with whitening"), ("9", "the set-up with the detector"))},
        **{f"p6-0.{n}": what for n, what in (("1", "the closed loop"), ("2", "nominal plant and S"), ("3", "the set-up"))},
    },
    PHOTO: {"figure-1.3": "the rig", "figure-3.1": "the rig", "figure-3.5": "the real-time computer", "p2-0.11": "the rig", "p3-0.5": "the rig", "p5-0.2": "the rig"},
    RIG: {
        "p3-0.8": "histogram of the healthy residual",
        "p2-0.13": "prediction error of the models of the rig", "p6-0.6": "verification, 0.5 A", "p6-0.7": "verification, 0.7 B at 2500 rpm", "p6-0.8": "verification, 0.97 A",
        "p6-0.9": "the same for the nominal model", "p6-0.10": "a detail of it",
    },
    EXAMPLE: {"figure-5.6": "efficiency for two faults", "p4-0.7": "two faults that share a phase", "p4-0.8": "the gains that tell them apart"},
}  # fmt: skip

FIGURES = [Figure(name, shows, reason=reason) for reason, figures in _REASONS.items() for name, shows in figures.items()]
