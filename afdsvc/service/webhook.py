"""Alarms to a web address: every change as one JSON document in a POST request."""

from __future__ import annotations

import json
import os
import urllib.parse
import urllib.request
from collections.abc import Callable, Iterable, Mapping
from typing import Any

from afdsvc.api.notify import NotifierDesign
from afdsvc.errors import BadInput
from afdsvc.plugins.hookspecs import hookimpl

SETTINGS = ("url", "headers_from_environment", "events", "timeout_seconds")


class Webhook:
    """POSTs to ``url``; ``events`` restricts to some (all by default).

    Site files end up in recordings, so secrets do not belong there: ``headers_from_environment`` maps a header to the name of the
    environment variable that holds its value, and an address with a password in it is refused.
    """

    name = "webhook"
    summary = "every change of an alarm as JSON to a web address"

    def open(self, settings: Mapping[str, Any]) -> Callable[[Mapping[str, Any]], None]:
        """Return what is called with every change; raises `BadInput` naming the setting that is wrong."""
        unknown = sorted(set(settings) - set(SETTINGS))
        if unknown:
            raise BadInput(f"webhook: unknown setting '{unknown[0]}'; known are {', '.join(SETTINGS)}")
        url = _checked_url(str(settings.get("url", "")))
        headers = _headers(settings.get("headers_from_environment", {}))
        events, timeout = settings.get("events"), float(settings.get("timeout_seconds", 5.0))

        def post(change: Mapping[str, Any]) -> None:
            if events is not None and change["event"] not in events:
                return
            body = json.dumps(change, allow_nan=False).encode()
            request = urllib.request.Request(url, body, {"Content-Type": "application/json", **headers}, method="POST")
            with urllib.request.urlopen(request, timeout=timeout) as answer:
                answer.read(1)

        return post


def _checked_url(url: str) -> str:
    parts = urllib.parse.urlsplit(url)
    if parts.scheme not in ("http", "https") or not parts.hostname:
        raise BadInput(f"webhook: url '{url}'; expected an address that begins with http:// or https://")
    if parts.password or parts.username:
        raise BadInput("webhook: url holds a user or password; put it into an environment variable (headers_from_environment)")
    return url


def _headers(names: Mapping[str, str]) -> dict[str, str]:
    missing = [variable for variable in names.values() if variable not in os.environ]
    if missing:
        raise BadInput(f"webhook: environment variable '{missing[0]}' is not set; it is to hold the value of a header")
    return {header: os.environ[variable] for header, variable in names.items()}


@hookimpl
def afdsvc_notifiers() -> Iterable[NotifierDesign]:
    """The webhook."""
    return [Webhook()]
