"""State-space algebra: coprime factors, J_K, LFT, S(theta), whitening, reduction, frequency response."""
