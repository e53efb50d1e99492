"""Registers the toy kind of findings and its algorithm."""

from brink.server.findings.kind import FINDINGS
from brink.server.problems.catalogue import ALGORITHMS
from brink.sim.catalogue import register
from support.extremes import ExtremesAlgorithm, ExtremesKind

register(FINDINGS, ExtremesKind.id, ExtremesKind)
register(ALGORITHMS, ExtremesAlgorithm.id, ExtremesAlgorithm)
