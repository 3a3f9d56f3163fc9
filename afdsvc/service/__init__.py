"""Clock, scheduler, bursts, safety, transport, recorder thread."""
