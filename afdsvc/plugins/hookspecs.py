"""The hooks of afdsvc: each hands out objects once, at start-up; loops call the objects, never the hooks."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import pluggy

from afdsvc.api.control_plugins import ControllerDesign, FaultKind
from afdsvc.api.detection import DetectorDesign
from afdsvc.api.notify import NotifierDesign
from afdsvc.api.retuning import RetunerDesign

PROJECT = "afdsvc"
hookspec = pluggy.HookspecMarker(PROJECT)
hookimpl = pluggy.HookimplMarker(PROJECT)


@hookspec
def afdsvc_controllers() -> Iterable[ControllerDesign]:  # type: ignore[empty-body]
    """Return the controllers a plugin offers."""


@hookspec
def afdsvc_faults() -> Iterable[FaultKind]:  # type: ignore[empty-body]
    """Return the kinds of fault a plugin offers."""


@hookspec
def afdsvc_detectors() -> Iterable[DetectorDesign]:  # type: ignore[empty-body]
    """Return the detectors a plugin offers."""


@hookspec
def afdsvc_physics() -> Iterable[Any]:  # type: ignore[empty-body]
    """Return the physics hypotheses a plugin offers."""


@hookspec
def afdsvc_retuners() -> Iterable[RetunerDesign]:  # type: ignore[empty-body]
    """Return the designs of Q for a damaged machine a plugin offers."""


@hookspec
def afdsvc_drivers() -> Iterable[Any]:  # type: ignore[empty-body]
    """Return the drivers of real hardware a plugin offers."""


@hookspec
def afdsvc_notifiers() -> Iterable[NotifierDesign]:  # type: ignore[empty-body]
    """Return the ways of telling people about alarms a plugin offers."""
