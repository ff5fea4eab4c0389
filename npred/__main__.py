"""`npred`, and `python -m npred`: signals are heard before the imports, which take a while."""

from npred.lab.report.terminal import interruption


def main() -> None:
    """Run the command of sys.argv and exit with its code."""
    interruption.listen()
    from npred.cli import main as command_line

    try:
        command_line()
    finally:
        interruption.leave()


if __name__ == "__main__":
    main()
