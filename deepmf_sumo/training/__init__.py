"""Scenes -> weights."""
