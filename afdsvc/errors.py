"""Every deliberate error of afdsvc.

A user reads one sentence that says what was found, where, and what was expected. `BadInput` is the caller's to mend (the
command line exits with 2), `Refused` is a request that would break a limit or a rule, everything else is unexpected.
"""

from __future__ import annotations


class AfdsvcError(Exception):
    """Base of every deliberate error."""


class BadInput(AfdsvcError):
    """Something handed in cannot be used; the message names file or argument, value found and value expected.

    Examples
    --------
    >>> import afdsvc
    >>> try:
    ...     afdsvc.load("missing.csv")
    ... except afdsvc.BadInput as error:
    ...     print(error)
    missing.csv: cannot be read: No such file or directory
    """


class Refused(AfdsvcError):
    """A request that would break a limit or a rule; the message is the reason, which whoever asked is given."""


class NotStabilising(BadInput):
    """The controller does not stabilise the plant; the message carries the offending pole."""


class IllConditioned(BadInput):
    """The numbers do not allow a trustworthy answer; the message carries the condition number and the limit."""
