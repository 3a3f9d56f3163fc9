"""Estimating the answer: modified Hansen, subspace, grey-box prediction error; one result type."""
