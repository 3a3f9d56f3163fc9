"""Integration of a made-up machine under its controller."""
