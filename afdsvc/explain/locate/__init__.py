"""Where simulation and recordings differ, and the picture of the law there."""
