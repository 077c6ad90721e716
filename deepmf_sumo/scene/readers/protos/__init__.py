"""Generated message classes of the WOMD scene; `make protos` rebuilds them."""
