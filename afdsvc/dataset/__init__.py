"""Recordings as arrays: experiments, periods, screening, glitches, columns."""
