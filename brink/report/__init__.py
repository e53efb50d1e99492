"""Reports: experiments, and the evidence for a boundary."""
