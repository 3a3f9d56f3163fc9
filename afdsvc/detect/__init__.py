"""The statistics detectors share: residuals, demodulation, thresholds, detection probability, fault curves."""
