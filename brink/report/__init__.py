"""Reports for people: experiments and the evidence for a boundary."""
