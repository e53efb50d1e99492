"""Programs of users: run in processes of their own, watched, and ended with all that they started."""

from brink.sim.programs.program import Ending, OutputTail, Program, Supervisor, exit_words, plain_environment

__all__ = ("Ending", "OutputTail", "Program", "Supervisor", "exit_words", "plain_environment")
