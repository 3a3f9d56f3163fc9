"""Why simulation and recordings differ: what physics the model leaves out."""
