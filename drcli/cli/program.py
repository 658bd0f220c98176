"""What every `dr` program runs: the command line, which Ctrl-C may end from its first moment on."""

import signal


def main() -> None:
    """Run the command line.

    Raises:
        SystemExit: Always, with the exit code.
    """
    try:
        from drcli.cli.app import main as run  # loading takes a while, and may be interrupted too

        run()
    except KeyboardInterrupt:
        raise SystemExit(130) from None
    finally:
        # It is over: a second Ctrl-C must not change how it ended.
        signal.signal(signal.SIGINT, signal.SIG_IGN)
