"""Complete commands and options in a shell."""

from __future__ import annotations

import argparse


def completion(parser: argparse.ArgumentParser, shell: str) -> str:
    """Write the script that completes a command line.

    Parameters
    ----------
    parser
        Of the whole program; the help of its parts is shown from here on.
    shell
        "bash", "zsh" or "tcsh".
    """
    import shtab  # bench extra

    for action in parser._actions:  # it leaves out what the help does not show
        action.help = None if action.help == argparse.SUPPRESS else action.help
    return str(shtab.complete(parser, shell))
