"""``afdsvc`` and ``python -m afdsvc`` are the command line."""

import signal


def main() -> None:
    """Run the command line; Ctrl-C ends it at once, the seconds of its imports included."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    from afdsvc.cli import run_cli as run

    run()


if __name__ == "__main__":
    main()
