"""Is there a gap between simulation and recording, and how large? A finding of its own, before any physics is named."""

from afdsvc.explain.gap.decision import flexible_prediction, gap_test
from afdsvc.explain.gap.finding import Gap
from afdsvc.explain.gap.settings import GapSettings
from afdsvc.explain.gap.signals import ResidualSignals

__all__ = ["Gap", "GapSettings", "ResidualSignals", "flexible_prediction", "gap_test"]
