"""A simulator and a problem as plug-ins: a car with a distance sensor brakes for a wall. Run it with

cd examples/plugins && brink --plugin brake_assist run brake_assist.yaml
"""

import numpy as np

from brink.search.algorithm import Scored
from brink.search.space import Categorical, Component, Real, SearchSpace
from brink.server.problems.base import NoParams, SimulatedProblem
from brink.server.problems.catalogue import PROBLEMS
from brink.sim.catalogue import SIMULATORS, register
from brink.sim.episode import EpisodeResult, EpisodeSpec, Verdict

GRIP = {"dry": 0.9, "wet": 0.6, "icy": 0.2}
SPACE = SearchSpace(
    (
        Component("scenario", (Categorical("road", tuple(GRIP)), Real("speed_mps", 5.0, 30.0, "m/s"))),
        Component("behaviour", (Real("bias_m", -10.0, 10.0, "m"), Real("delay_s", 0.0, 1.0, "s"))),
    )
)


class BrakeAssistSimulator:
    """Brakes when the sensed distance falls below the dry braking distance plus a margin; gusts push it forward."""

    def run(self, spec, *, record=False):
        spec.check_for("brake-assist-sim@1", longest_s=10.0)
        road, speed, bias, delay = (*spec.scenario.values(), *spec.behaviour.values())
        gust = np.random.default_rng(spec.seed).normal(0.0, 0.5)
        brakes_at = speed**2 / (2 * 9.81 * GRIP["dry"]) + 15.0 - bias - speed * delay
        gap = brakes_at - speed**2 / (2 * 9.81 * GRIP[road]) - gust
        verdict = Verdict(robustness=gap, unit="m", violated_at_s=None)  # computed at once: there is no time
        return EpisodeResult(
            verdicts={"margin": verdict}, objectives={"gap_m": gap}, features={}, provenance={}
        )


class BrakeAssist(SimulatedProblem):
    """Finds which sensor faults are hazardous on which road."""

    id, summary, params_type = "brake-assist@1", "A sensor's bias and delay against road and speed.", NoParams
    needs, timeout_s, space, algorithm_defaults = "brake-assist-sim@1", 10.0, SPACE, {"radius": 0.1}

    def __init__(self, params):
        pass

    def episode(self, vectors, seed):
        decoded = SPACE.decode(vectors)
        return EpisodeSpec(
            simulator=self.needs,
            scenario=decoded["scenario"],
            behaviour=decoded["behaviour"],
            requirements=("margin",),
            seed=seed,
            duration_s=10.0,
        )

    def evaluation(self, outcome):
        gap = outcome.verdicts["margin"].robustness
        return Scored(unsafe=gap < 0, robustness=gap, objectives=outcome.objectives)


register(SIMULATORS, "brake-assist-sim@1", BrakeAssistSimulator)
register(PROBLEMS, "brake-assist@1", BrakeAssist)
