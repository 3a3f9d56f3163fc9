"""Identification methods: Hansen scheme, subspace, predictor-based subspace, grey box, indirect."""
