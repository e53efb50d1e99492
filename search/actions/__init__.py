"""Scripted traffic participants as genes: how they are written down, move, differ, and vary."""
