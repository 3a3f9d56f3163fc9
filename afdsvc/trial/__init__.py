"""Blind trials: recordings in which something is hidden, made apart from everything that is to find it, and the score."""

from afdsvc.trial.answer import Answer, Hidden
from afdsvc.trial.folder import Paths, write
from afdsvc.trial.generate import NOTHING, Trial, Wish, generate, generate_several
from afdsvc.trial.options import Options
from afdsvc.trial.oracle import Oracle, oracle
from afdsvc.trial.seal import open_seal, seal

__all__ = [
    "NOTHING", "Answer", "Hidden", "Options", "Oracle", "Paths", "Trial", "Wish", "generate", "generate_several", "open_seal",
    "oracle", "seal", "write",
]
