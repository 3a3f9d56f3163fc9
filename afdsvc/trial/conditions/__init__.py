"""What a machine is recorded under: excitation, ambient signals, noise."""
