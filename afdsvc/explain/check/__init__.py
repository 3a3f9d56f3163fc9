"""Before any fit: columns, units, clocks, excitation and what the recordings can show."""
