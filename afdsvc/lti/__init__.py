"""State-space algebra: coprime factors, J_K, LFT, S(theta), whitening, reduction, frequency response."""

from afdsvc.lti.python_control import CoprimeFactors, augmented_controller, coprime, deviation, whitening

__all__ = ["CoprimeFactors", "augmented_controller", "coprime", "deviation", "whitening"]
