"""Result folder -> pictures and tables."""
