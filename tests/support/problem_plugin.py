"""Registers the problems of the tests: name it in ``BRINK_PLUGINS``, with tests/ on ``PYTHONPATH``."""

from support.problems import register_all

register_all()
