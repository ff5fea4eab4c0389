"""`python -m npred`: the command line where the script is not on the path."""

from npred.cli import main

main()
