"""Rerun logging and blueprint."""

from __future__ import annotations

from afdsvc.present.rerun.history import review_history
from afdsvc.present.rerun.recorded import open_viewer, review_recording, review_recordings

__all__ = ["open_viewer", "review_history", "review_recording", "review_recordings"]
