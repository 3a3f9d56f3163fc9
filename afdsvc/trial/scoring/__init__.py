"""Scores of an explanation against the sealed answer, and the tables of a study."""
