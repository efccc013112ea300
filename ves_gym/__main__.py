"""`python -m ves_gym COMMAND`: the program `ves-gym`, where scripts are not on the path."""

import sys

from ves_gym.cli.main import main

if __name__ == "__main__":
    sys.exit(main())
