"""A figure or table of the thesis: what it shows, and its numbers beside ours."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from benchmarks.thesis.recorded import Measured


@dataclass(frozen=True)
class Row:
    """A number, or a statement (True or False), as printed and as found here.

    ``erratum`` explains a difference; ``ours`` is then compared with ``instead``, what it says, rather than with the print.
    """

    what: str
    printed: float | bool | None
    ours: float | bool
    tolerance: float = 0.0
    erratum: str = ""
    instead: float | bool | None = None

    @property
    def holds(self) -> bool:
        """Whether what was found is what was expected."""
        expected = self.instead if self.erratum else self.printed
        return expected is not None and abs(float(self.ours) - float(expected)) <= self.tolerance


@dataclass(frozen=True)
class Figure:
    """``name`` as in ``p5-0.14``, in which chapter or paper, what it shows, and the function that remakes its numbers; else the reason.

    ``recorded`` makes them from a recording of the ``experiment`` (see `benchmarks.thesis.recorded`), of the simulator or of a rig.
    """

    name: str
    shows: str
    remade: Callable[[], Sequence[Row]] | None = None
    reason: str = ""
    long: bool = False
    recorded: Callable[[Measured], Sequence[Row]] | None = None
    experiment: str = ""

    @property
    def page(self) -> str:
        """The page it is on: ``chapter-4``, ``p5``."""
        return self.name.partition("-")[0] if self.name.startswith("p") else f"chapter-{self.name.partition('-')[2].partition('.')[0]}"

    @property
    def command(self) -> str:
        """What remakes it."""
        return f"python -m benchmarks.thesis {self.name}"
