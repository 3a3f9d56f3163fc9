"""From evidence to an answer: which names are claimed, how surely, and what remains."""
