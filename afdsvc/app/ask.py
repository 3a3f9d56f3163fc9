"""Requests to the running service of a site."""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial
from typing import Any

from afdsvc.errors import AfdsvcError
from afdsvc.files.site import Site
from afdsvc.transport.access_rules import access_of
from afdsvc.transport.zenoh_session import Transport
from afdsvc.wire.keys import Keys
from afdsvc.wire.requests import QUESTIONS, RETUNING, ask

DESIGN_SECONDS = {"burst": 60.0, "retune": 600.0}  # what is designed before it is accepted
ASKED_SECONDS = 0.05  # between two questions whether it is
SILENT_SECONDS = 2.0  # of waiting, after which a person hears why


def ask_service(site: Site, name: str, asked_by: str, waiting: Callable[[], object] = lambda: None, **arguments: Any) -> Any:
    """Ask the running service of a site; returns JSON values, raises the service's own sentence.

    ``waiting`` is called once when what is asked for is still being designed after `SILENT_SECONDS`.
    On a secured site ``asked_by`` is the name in the certificate that is shown.
    """
    with Transport(site.transport, False, access_of(site, asked_by)) as transport:
        keys, patience, security = Keys(site.site), site.transport.patience_seconds, site.transport.security
        tunes = security is not None and name in RETUNING and asked_by in security.tuners
        key = keys.retuning(asked_by) if tunes else keys.command(asked_by if security else "")
        question = partial(transport.ask, keys.question(), timeout=patience)
        command = partial(transport.ask, key, timeout=patience)
        if name not in DESIGN_SECONDS:
            return ask(question if name in QUESTIONS else command, name, asked_by, **arguments)
        answer = ask(command, name, asked_by, later=True, **arguments)
        began, silent = time.monotonic(), True
        while "ticket" in answer:
            waited = time.monotonic() - began
            if waited > DESIGN_SECONDS[name]:
                raise AfdsvcError(f"no {name} has been designed and accepted within {DESIGN_SECONDS[name]:g} s")
            if silent and waited > SILENT_SECONDS:
                silent = False
                waiting()
            time.sleep(ASKED_SECONDS)
            answer = ask(question, "ticket", asked_by, ticket=answer["ticket"])
        return answer
