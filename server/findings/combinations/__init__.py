"""Findings of the kind `combinations`: chains of techniques that are hazardous together."""
