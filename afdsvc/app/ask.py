"""Requests to the running service of a site."""

from __future__ import annotations

from typing import Any

from afdsvc.files.site import Site
from afdsvc.service import operator_requests
from afdsvc.service.operator_requests import QUESTIONS
from afdsvc.transport.access_rules import access_of
from afdsvc.transport.zenoh_session import Transport
from afdsvc.wire.keys import Keys

DESIGN_SECONDS = 60.0  # a burst is designed before it is accepted


def ask_service(site: Site, name: str, asked_by: str, **arguments: Any) -> Any:
    """Ask the running service of a site; returns JSON values, raises the service's own sentence.

    On a secured site ``asked_by`` is the name in the certificate that is shown.
    """
    with Transport(site.transport, False, access_of(site, asked_by)) as transport:
        keys = Keys(site.site)
        key = keys.question() if name in QUESTIONS else keys.command()
        timeout = DESIGN_SECONDS if name == "burst" else site.transport.patience_seconds
        return operator_requests.ask(lambda payload: transport.ask(key, payload, timeout), name, asked_by, **arguments)
