"""FMUs as simulators: which may run on this machine, how an episode steps one, and what campaign files say of one."""
