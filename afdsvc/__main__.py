"""``python -m afdsvc`` is the command line."""

from afdsvc.cli import main

main()
