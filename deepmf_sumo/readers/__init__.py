"""Recorded file -> Scene. One file a format; `base.Reader` is the contract."""
