"""What detectors read from a block: innovations, regressors, demodulated lines, data checks."""
