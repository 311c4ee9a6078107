"""The command line: `python -m rollouts NAME …`."""

import argparse

from rollouts import write

if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=write.__doc__)
    parser.add_argument("names", nargs="+", metavar="NAME")
    write(parser.parse_args().names)
