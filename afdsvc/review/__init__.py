"""Rerun logging and blueprint."""

from __future__ import annotations

from afdsvc.review.recorded import open_viewer, review_recording

__all__ = ["open_viewer", "review_recording"]
