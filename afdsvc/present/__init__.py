"""Terminal, HTML pages and Rerun."""
