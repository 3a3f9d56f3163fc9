"""Recordings as arrays: experiments, periods, screening, glitches, angles, columns."""
