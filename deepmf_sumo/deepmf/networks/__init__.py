"""View -> Forecast: features, networks, weights."""
