"""The statistics detectors share: thresholds, run lengths, demodulation, fault curves, whiteness, power."""
