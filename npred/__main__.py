"""`npred`, and `python -m npred`: signals are heard before the imports, which take a while."""

import sys

from npred.terminal import interruption


def main() -> None:
    """Run the command of sys.argv and exit with its code."""
    interruption.listen()
    try:
        from npred.cli import main as command_line

        command_line()
    except KeyboardInterrupt:
        interruption.say(lambda line: print(f"error: {line}", file=sys.stderr))
        sys.exit(interruption.code())


if __name__ == "__main__":
    main()
