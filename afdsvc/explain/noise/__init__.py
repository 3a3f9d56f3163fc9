"""What of a residual is noise: its spectrum, its correlation time, surrogates of it."""
