"""Designing the question: efficiency of excitation, bursts and their budget, what a burst will tell."""
