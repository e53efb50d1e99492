"""What one line of an experiment's tables beside another allows to be said."""

import pytest

from brink.search.analysis.conclusions import conclusion
from brink.search.analysis.experiment_tables import Duel, Line, Measure
from brink.search.statistics import Comparison

GA, RS, GA_CONTROL = (
    Line(problem="gap", method=method, control=control)
    for method, control in (("GA", False), ("RS", False), ("GA", True))
)


def duel(second: Line, p: float, adjusted: float, a12: float) -> Duel:
    result = Comparison(u=1.0, p_value=p, a12=a12)
    return Duel(
        first=GA, second=second, measure=Measure.STRICT, t_b=0.1, d_th=0.2, result=result, adjusted=adjusted
    )


@pytest.mark.parametrize(
    ("second", "p", "adjusted", "a12", "low", "said"),
    [
        (RS, 0.001, 0.01, 0.9, (), "GA finds more"),
        (RS, 0.001, 0.01, 0.1, (), "RS finds more"),
        (RS, 0.01, 0.2, 0.9, (), "it may be chance"),
        (RS, 0.3, 1.0, 0.6, (), "show no difference"),
        (RS, 0.001, 0.01, 0.9, ("GA",), "GA finds more"),  # its control is not asked
        (GA_CONTROL, 0.001, 0.01, 0.9, (), "5.0 are owed to behaviour"),
        (GA_CONTROL, 0.01, 0.2, 0.9, (), "it may be chance"),
        (GA_CONTROL, 0.3, 1.0, 0.6, (), "no more than scenarios and chance give"),
        (GA_CONTROL, 0.001, 0.01, 0.9, ("GA",), "proves nothing"),
    ],
)
def test_no_more_is_concluded_than_the_test_and_the_control_bear_out(
    second: Line, p: float, adjusted: float, a12: float, low: tuple[str, ...], said: str
) -> None:
    assert said in conclusion(duel(second, p, adjusted, a12), 12.0, 7.0, low)


def test_a_line_below_its_control_owes_nothing_to_behaviour() -> None:
    assert "no more than" in conclusion(duel(GA_CONTROL, 0.001, 0.01, 0.1), 7.0, 12.0, ())
