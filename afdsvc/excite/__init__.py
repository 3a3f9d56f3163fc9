"""Designing the question: efficiency, bursts, amplitude and energy budgets."""
