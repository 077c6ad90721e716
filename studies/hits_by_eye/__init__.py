"""Hits judged by eye, to compare with the ladder."""
