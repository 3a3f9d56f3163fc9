"""Direct spectral identification in closed loop against the Hansen scheme while noise grows (thesis Eq 4.5-4.9).

python benchmarks/identify/bias.py
"""

from __future__ import annotations

import numpy as np
from bearing import TRUE, binary, run
from matplotlib.figure import Figure
from matplotlib.ticker import NullFormatter
from page import picture, table, write
from spectral import direct_spectral, indirect_spectral

from afdsvc.dataset.arrays import InputOutputData
from afdsvc.identify.methods.hansen import rebuilt_plant
from afdsvc.identify.methods.pbsid import decompose_predictor, realise_predictor
from afdsvc.identify.methods.subspace import decompose, realise
from afdsvc.identify.reduction import compare_reductions, refine
from afdsvc.lti.frequency import frequency_response
from afdsvc.lti.python_control import factorise
from afdsvc.lti.statespace import ComplexArray, StateSpace

GAIN, SAMPLES, SEGMENT = 0.2, 200_000, 2000
NOISE = (0.01, 0.1, 0.3, 1.0, 3.0, 10.0)


def relative_error(found: ComplexArray, truth: ComplexArray) -> float:
    """Return the median over frequency of ``|found - truth| / |truth|`` in spectral norms."""
    return float(
        np.median(np.linalg.norm(found - truth, ord=2, axis=(1, 2)) / np.linalg.norm(truth, ord=2, axis=(1, 2)))
    )


def study() -> None:
    """Write docs/reference/identification-bias.md."""
    K = GAIN * np.eye(2)
    fact = factorise(StateSpace(0.97 * TRUE.A, TRUE.B, TRUE.C, TRUE.D, TRUE.dt), StateSpace.gain(K, TRUE.dt))
    rows, shown = [], {}
    for ratio in NOISE:
        rng = np.random.default_rng(1)
        # noise in multiples of what the excitation makes of the output
        alpha = binary(rng, SAMPLES, 1.0)
        quiet, _ = run(fact, TRUE, alpha, rng, noise=0.0)
        record, signals = run(fact, TRUE, alpha, rng, noise=ratio * quiet.y.std() / np.sqrt(0.135))
        omega, direct = direct_spectral(record, SEGMENT)
        _, indirect = indirect_spectral(record, alpha, SEGMENT)
        band = (omega > 300) & (omega < 4000)
        omega, direct, indirect = omega[band], direct[band], indirect[band]
        truth = frequency_response(TRUE, omega)
        found = {"direct": direct, "indirect": indirect, **{k: frequency_response(s, omega) for k, s in parametric(fact, record, signals).items()}}
        inverse = np.broadcast_to(np.linalg.inv(K), truth.shape)
        away = [relative_error(found[name], inverse) for name in ("direct", "Hansen")]
        rows.append([f"{ratio:g}", *(f"{100 * relative_error(g, truth):.1f} %" for g in found.values()), *(f"{100 * d:.1f} %" for d in away)])
        print(rows[-1], flush=True)
        shown[ratio] = (omega, truth, found)
    labels = list(shown[NOISE[0]][2])
    parts = [
        f"Gas bearing with the proportional controller K = {GAIN} (positive feedback), nominal model 0.97 A, random binary excitation in alpha, "
        f"{SAMPLES:,} samples, white output noise. Distances are medians over 300 to 4000 rad/s of the relative error in spectral norm. "
        "\"Direct\" is the ratio of spectra of y and u (Welch, segments of "
        f"{SEGMENT}), \"indirect\" that through alpha, \"Hansen\" S by PO-MOESP, G(S) reduced to order 6 and refined, \"PBSIDopt\" from u and y.",
        picture(figure(shown), "identification-bias"),
        table(["noise / excited output (rms)", *(f"{label}: error" for label in labels), "direct: distance to 1/K", "Hansen: distance to 1/K"], rows),
        "As the noise grows, the direct ratio leaves the plant and ends at the inverse of the controller, as Eq 4.9 of the thesis says; more "
        "samples do not help. The estimates through alpha lose precision, not truth.",
    ]
    write("identification-bias", "What feedback does to direct identification", "python benchmarks/identify/bias.py", parts)


def parametric(fact, record: InputOutputData, signals: InputOutputData) -> dict[str, StateSpace]:
    """Return the plants found by the Hansen scheme and by PBSIDopt."""
    full = rebuilt_plant(fact, realise(decompose([signals], 30), 12, stable=True).system)
    start = next(r.system for r in compare_reductions(full, fact, 6, [record]) if r.loop_stable)
    return {
        "Hansen": refine(fact, [signals], start).system,
        "PBSIDopt": realise_predictor(decompose_predictor([record], 60), 6).system,
    }


def figure(shown) -> Figure:
    """Return magnitudes of the first entry at little, equal and dominant noise."""
    fig = Figure(figsize=(10, 3.4), layout="constrained")
    for ax, ratio in zip(fig.subplots(1, 3, sharey=True), (0.1, 1.0, 10.0), strict=True):
        omega, truth, found = shown[ratio]
        ax.loglog(omega, np.abs(found["direct"][:, 0, 0]), ".", ms=3, color="#c8553d", label="direct")
        ax.loglog(omega, np.abs(found["indirect"][:, 0, 0]), ".", ms=2, color="#bbbbbb", label="indirect")
        ax.loglog(omega, np.abs(found["Hansen"][:, 0, 0]), color="#1b6ca8", label="Hansen")
        ax.loglog(omega, np.abs(truth[:, 0, 0]), "k--", lw=1, label="truth")
        ax.axhline(1 / GAIN, color="0.4", lw=0.8, ls=":")
        ax.set_xticks([500, 1000, 2000, 4000], ["500", "1000", "2000", "4000"], minor=False)
        ax.xaxis.set_minor_formatter(NullFormatter())
        ax.set(title=f"noise / excited output = {ratio:g}", xlabel="rad/s")
    fig.axes[0].legend(fontsize=7, frameon=False)
    fig.axes[0].set_ylabel("horizontal to horizontal [um/V]; dotted 1/K", fontsize=8)
    return fig


if __name__ == "__main__":
    study()
