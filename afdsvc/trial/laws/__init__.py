"""Laws of the truth generator: what acts in a made-up machine, compiled, in functional forms of their own."""
