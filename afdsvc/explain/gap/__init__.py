"""Is there a gap between simulation and recording, and how large?"""
