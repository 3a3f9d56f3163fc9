"""Is there a gap between simulation and recording, and how large? A finding of its own, before any physics is named."""

from afdsvc.explain.gap.decision import flexible_prediction, gap
from afdsvc.explain.gap.finding import Gap
from afdsvc.explain.gap.settings import GapSettings
from afdsvc.explain.gap.signals import Signals

__all__ = ["Gap", "GapSettings", "Signals", "flexible_prediction", "gap"]
