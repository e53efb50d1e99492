"""Search algorithms for hazard boundaries, and the analysis of their archives; needs only numpy and scipy."""
