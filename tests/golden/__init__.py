"""Answers of the chain and of the command line, stored from commit to commit.

`python -m tests.golden` computes them again, prints in words what moved, and stores them with `--update`.
"""
