"""The next experiment: the excitation that separates look-alikes, or that moves the machine at all."""
