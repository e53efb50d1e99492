"""How many connections a process may hold: each is an open file, and most systems allow 1,024 unless asked."""

import resource
from typing import Final

_MOST: Final = 65_536


def allow_many_open_files() -> None:
    """Raise this process's own limit as far as the system lets it."""
    now, most = resource.getrlimit(resource.RLIMIT_NOFILE)
    wanted = _MOST if most == resource.RLIM_INFINITY else min(most, _MOST)
    if now != resource.RLIM_INFINITY and now < wanted:
        resource.setrlimit(resource.RLIMIT_NOFILE, (wanted, most))
