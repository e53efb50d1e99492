"""Measures what SiMOOD must show on this installation (specification: acceptance A0 to A8)."""
