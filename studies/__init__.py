"""Studies: one script, one question, one chart and one CSV each. Run as `python -m studies.NAME`."""

import argparse


def options(study: str, text: str) -> argparse.ArgumentParser:
    """The command line of a study, which says the first line of its text; a study adds what it can be told."""
    return argparse.ArgumentParser(prog=f"python -m studies.{study}", description=text.split("\n")[0])
