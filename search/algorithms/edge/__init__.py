"""`edge@1`: pairs of solutions across the boundary, one safe and one unsafe, at most `eps` apart.

The search explores at random, then looks for *partners*: the numbers of a simulated solution, its *anchor*, are drawn
again, and the draw that a surrogate considers most likely to change the verdict is simulated under the anchor's
episode seed. If the verdict changes, the two are a *bracket*. A *probe* between them, under the same seed, replaces
the end whose verdict it shares, until the bracket is a tight pair. *Checks* then simulate both sides again, each
under a seed of its own; a pair that does not keep its verdicts is a chancy place.

The sides of a bracket share an episode seed: otherwise chance would decide where the verdict changes. When the budget
only just suffices to finish the open brackets, no more are opened, and generations become smaller.

A search that starts from known results explores less by as many. The surrogate learns from them, and then proposes
anchors, known solutions and new ones. No bracket rests on a known result: a known solution is simulated again under a
seed of this search. Where known results are a pair already, the search looks for no further one.

Source: ours; see docs/explanation/pairs.md.
"""

from brink.search.algorithms.edge.brackets import MAX_FAILURES
from brink.search.algorithms.edge.search import Edge
from brink.search.algorithms.edge.state import Bracket, EdgeConfig, EdgeState, Purpose, Status

__all__ = ["MAX_FAILURES", "Bracket", "Edge", "EdgeConfig", "EdgeState", "Purpose", "Status"]
