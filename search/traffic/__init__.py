"""Scripted traffic participants as a genome: encoding, constraint, motion, distances and variation."""
