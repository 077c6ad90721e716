"""The ten situations with people of Euro NCAP's protocol; see README.md."""
