"""Design of excitation: its efficiency, bursts and their budget, expected detection."""
