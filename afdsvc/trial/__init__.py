"""Blind trials: recordings in which something is hidden, made apart from everything that is to find it, and the score."""

from afdsvc.trial.answer import Hidden, TrialAnswer
from afdsvc.trial.field.answer import FieldAnswer
from afdsvc.trial.field.catalogue import FieldOptions
from afdsvc.trial.field.generate import FieldTrial
from afdsvc.trial.folder import TrialPaths, write
from afdsvc.trial.generate import NOTHING, BlindTrial, TrialRequest, generate_several, generate_trial
from afdsvc.trial.options import Options
from afdsvc.trial.pages import markdown, page
from afdsvc.trial.plan import FIELD, Request, field_plan, make_trial, plan
from afdsvc.trial.scoring.field_score import FieldScore, field_oracle, field_score
from afdsvc.trial.scoring.oracle import Oracle, oracle
from afdsvc.trial.scoring.score import Score, score
from afdsvc.trial.seal import open_seal, seal
from afdsvc.trial.study import results, study, write_only

__all__ = [
    "FIELD",
    "NOTHING",
    "BlindTrial",
    "FieldAnswer",
    "FieldOptions",
    "FieldScore",
    "FieldTrial",
    "Hidden",
    "Options",
    "Oracle",
    "Request",
    "Score",
    "TrialAnswer",
    "TrialPaths",
    "TrialRequest",
    "field_oracle",
    "field_plan",
    "field_score",
    "generate_several",
    "generate_trial",
    "make_trial",
    "markdown",
    "open_seal",
    "oracle",
    "page",
    "plan",
    "results",
    "score",
    "seal",
    "study",
    "write",
    "write_only",
]
