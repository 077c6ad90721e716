"""Every measured number of README and site, made again by one command."""
