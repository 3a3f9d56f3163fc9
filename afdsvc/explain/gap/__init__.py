"""Is there a gap between simulation and recording, and how large? A finding of its own, before any physics is named."""
