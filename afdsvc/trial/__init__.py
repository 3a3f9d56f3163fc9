"""Blind trials: recordings in which something is hidden, made apart from everything that is to find it, and the score."""

from afdsvc.trial.answer import FieldAnswer, Hidden, TrialAnswer
from afdsvc.trial.field.catalogue import FieldOptions
from afdsvc.trial.field.generate import FieldTrial
from afdsvc.trial.field_score import FieldScore, field_oracle, field_score
from afdsvc.trial.folder import TrialPaths, open_seal, seal, write
from afdsvc.trial.generate import NOTHING, BlindTrial, TrialRequest, generate_several, generate_trial
from afdsvc.trial.machines import Options
from afdsvc.trial.oracle import Oracle, oracle
from afdsvc.trial.pages import markdown, page
from afdsvc.trial.score import Score, score
from afdsvc.trial.study import FIELD, Request, field_plan, make_trial, plan, results, study, write_only

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
