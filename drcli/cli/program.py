"""Entry points; Ctrl-C may end them at any time."""

import os
import shlex
import signal
import sys


def main() -> None:
    """Run the command line.

    Raises:
        SystemExit: Always, with the exit code.
    """
    if os.name == "nt":
        from drcli.base.system_calls import no_such_system

        refusal = no_such_system()
        sys.stderr.write(f"{refusal}\n{refusal.remedy}\n")
        raise SystemExit(refusal.code)
    try:
        from drcli.cli.app import main as run  # takes a while; Ctrl-C may interrupt it

        run()
    except ImportError as error:
        from drcli.base.installation import import_error

        broken = import_error(error)
        if broken is None:
            raise
        sys.stderr.write(f"Error: {broken}\n  Try: {broken.remedy}\n")
        raise SystemExit(broken.code) from None
    except KeyboardInterrupt:
        raise SystemExit(130) from None
    finally:
        # A second Ctrl-C must not change the exit code.
        signal.signal(signal.SIGINT, signal.SIG_IGN)


def answer_former_shells() -> None:
    """Answer `drcli-complete SHELL WORD...` of version 0.1.0."""
    from drcli.cli.completion import ASKS, LINE

    words = [word.strip("\"'") for word in sys.argv[2:]]
    if "=" not in words:  # bash passes NAME=value as three words
        os.environ.update({**ASKS, LINE: shlex.join(words)})
        main()
