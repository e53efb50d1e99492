"""The list of hostile requests, by groups as `docs/reference/security.md` has them."""

from support.attacks.access import ACCESS
from support.attacks.bodies import BODIES
from support.attacks.http import HTTP
from support.attacks.names import NAMES
from support.attacks.reach import REACH
from support.attacks.workers import WORKERS

ATTACKS = (*ACCESS, *WORKERS, *BODIES, *NAMES, *HTTP, *REACH)

__all__ = ["ATTACKS"]
