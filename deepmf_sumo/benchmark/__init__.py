"""Specs -> tasks -> isolated workers -> result folder."""
